"""Row 1: batches of a thousand instants each, within all limits."""

import pytest

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


def test_many_instants_cost_their_source_alone(fair) -> None:
    assert fair("instants").problems
