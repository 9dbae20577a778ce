"""Short forms of the attacks, one after the other on one scene, for every run of the tests."""

import os

import pytest

from comotion_tools.soak.attacks import NAME

from .arena import HONEST
from .conftest import BUSY

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]
ATTACKS = ("instants", "new-spaces", "names", "statuses", "large")
SECONDS = 1.0


def test_short_attacks_are_laid_to_their_source_and_cost_the_others_nothing(enter):
    arena = enter()
    before, named = arena.counted(), set()
    for attack in ATTACKS:
        with arena.attacked_by(attack, SECONDS):
            arena.wait(SECONDS + 0.5)
        named |= arena.problems()
    after = arena.counted()
    sent, fused = after[0] - before[0], after[1] - before[1]
    assert sent > 100
    assert sent == fused or os.getloadavg()[0] > BUSY, named
    assert {source for kind, source in named if kind in ("limit", "over-budget")} >= {NAME}
    assert not {kind for kind, source in named if source in HONEST} - {"silent"} or os.getloadavg()[0] > BUSY
    assert ("defect", None) not in named
    assert not any(one["lost"] for one in arena.sessions() if one["source"] in HONEST)
