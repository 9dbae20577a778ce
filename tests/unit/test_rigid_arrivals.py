"""Features that may be a lost body's return belong to nobody until their motion is known."""

import numpy as np
import pytest

from comotion.partition import NO_HYPOTHESIS
from comotion.rigid.arrivals import undecided
from comotion.rigid.assignment import OUTLIER
from comotion.rigid.kernels.records import ROUND
from comotion.rigid.resampling import Frames
from comotion.rigid.subset import Scene

OLD, GONE, NEW = slice(0, 10), slice(10, 14), slice(14, 20)


def scene(*, lost: bool, crowded: bool = True) -> Scene:
    """Ten features at rest, four of hypothesis 2 that ended, and six that were born just now."""
    rng = np.random.default_rng(0)
    n, count = 20, 30
    w = np.zeros((n, count))
    w[OLD], w[GONE, :15], w[NEW, -2:] = 1, 1, 1
    places = rng.uniform(-1, 1, (n, 3))
    places[NEW] = rng.uniform(-0.01, 0.01, (6, 3)) if crowded else places[:6] + 0.001
    ones, current, before = np.ones(n), np.ones(n, bool), np.full(n, 1)
    current[GONE], before[GONE], before[NEW] = False, 2, NO_HYPOTHESIS
    if not lost:
        before[0] = 2
    frames = Frames(
        dim=3,
        stamps=np.arange(count, dtype=np.int64) * 66_000_000,
        y=np.repeat(places[:, None], count, 1),
        w=w,
        owner=np.arange(n),
        weight=ones,
        noise=ones * 1e-6,
        tolerance=ones * 1e-6,
        metric=np.tile(ROUND, (n, 1)),
        spectrum=np.tile([1.0, 0.0, 0.0], (n, 1)),
        key=np.arange(n),
        life=(w > 0).sum(1) / 15,
        current=current,
    )
    nobody = np.zeros(n, bool)
    return Scene(frames, places, frames.life >= 0.3, before, 1, nobody, nobody, nobody)


@pytest.mark.parametrize("nearest", [0, 1])
def test_a_crowd_of_newborn_features_is_undecided_while_a_body_is_lost(nearest):
    labels = undecided(scene(lost=True), np.full(20, nearest))
    assert (labels[NEW] == OUTLIER).all()
    assert (labels[:14] == nearest).all()


def test_without_a_lost_body_and_apart_from_each_other_their_place_decides():
    nothing = np.zeros(20, np.intp)
    assert (undecided(scene(lost=False), nothing) == 0).all()
    assert (undecided(scene(lost=True, crowded=False), nothing) == 0).all()
