"""Row 7: a source that sees what the others see, and turns away."""

import pytest

from comotion_tools.soak.attacks import NAME

pytestmark = [pytest.mark.e2e, pytest.mark.long, pytest.mark.timeout(900)]


def test_a_drifting_source_takes_no_ids_along_and_is_named(enter) -> None:
    outcome = enter().attack("drift", 20.0)
    assert ("drifts", NAME) in outcome.problems
    assert not outcome.blames_the_honest, outcome
    assert outcome.renamed == 0, outcome
    assert outcome.lost == 0, outcome
