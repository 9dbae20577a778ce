"""Row 5: bytes and declarations."""

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


@pytest.mark.parametrize("attack", ["large", "tokens"])
def test_bytes_and_tokens_cost_their_source_alone(fair, attack) -> None:
    before, most, after = fair(attack).memory_mb
    assert after - before < 60
    # Two queues of 32 and 64 MB, their messages decoded, and 5000 trajectories.
    assert most - before < 500
