"""Each script attacks a running scene, see :mod:`.arena`; ``make test-long`` runs them."""

from contextlib import ExitStack

import pytest

from .arena import BOUND_S, Arena

SECONDS = 6.0
BUSY = 2.0
"""Load of the machine beyond which the bound on gaps does not hold."""


@pytest.fixture
def enter(tmp_path):
    """Start a scene: ``enter(secure=True)``."""
    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(Arena(tmp_path, **options))


@pytest.fixture
def fair(enter):
    """Attack a scene: the honest lose nothing, are not blamed, and updates come."""

    def run(attack, **options):
        outcome = enter(**options).attack(attack, SECONDS)
        assert outcome.lost == 0, outcome
        assert outcome.told_lost == 0, outcome
        assert not outcome.blames_the_honest, outcome
        assert outcome.gap_s < BOUND_S or outcome.load > BUSY, outcome
        return outcome

    return run
