"""Row 2: many spaces, and many names."""

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


@pytest.mark.parametrize("attack", ["spaces", "new-spaces", "names"])
def test_many_spaces_or_names_cost_their_source_alone(fair, attack) -> None:
    fair(attack)
