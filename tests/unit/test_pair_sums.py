"""Cases of the pair sums that chance seldom makes."""

import math

import numpy as np
import pytest

from ..reference.side_by_side import MS, T0, SideBySide


def at(ms: float) -> int:
    return T0 + round(ms * MS)


@pytest.mark.parametrize("wild", [(0, 1000), (1000,)])
def test_a_wild_observation_leaves_no_trace_after_it_has_gone(wild):
    both = SideBySide(2, 0.1)
    rng = np.random.default_rng(0)
    for ms in range(0, 3000, 50):
        points = {k: np.array([k, 0.0]) + rng.normal(0, 1e-3, 2) for k in range(4)}
        if ms in wild:
            points[2] = np.array([1e9, -1e9])
        both.observe(at(ms), {k: tuple(x) for k, x in points.items()})
        both.evict(at(ms) - both.span)
        if ms in (1950, 2000, 2050, 2500):
            both.check()
    assert len(both.slots) == 4


@pytest.mark.parametrize("step", [0, 30])
def test_small_motion_far_apart_keeps_its_digits(step):
    both = SideBySide(2, 0.1)
    for ms in range(0, 1000, 100):
        both.observe(at(ms), {0: (0.0, 0.0)})
        both.observe(at(ms + step), {1: (1e3 + 1e-3 * math.sin(ms), 0.0)})
    both.check_affinities()


@pytest.mark.parametrize("v_move", [None, 0.1])
def test_affinities_are_those_of_the_definitions(v_move):
    rng = np.random.default_rng(0)
    both = SideBySide(3, v_move)
    amplitude, pace, centre = rng.uniform(0, 0.5, (5, 3)), rng.uniform(0, 6, (5, 3)), rng.normal(0, 1, (5, 3))
    for ms in range(0, 2200, 10):
        x = centre + amplitude * np.sin(pace * ms * 1e-3) + rng.normal(0, 0.003, (5, 3))
        both.observe(at(ms), {k: tuple(x[k]) for k in range(5) if ms % (20, 30, 70, 100, 250)[k] == 0})
        if ms % 100 == 0:
            both.evict(at(ms) - both.span)
        if ms % 300 == 0:
            both.check_affinities()
