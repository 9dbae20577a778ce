"""Cases of the pair sums that chance seldom makes."""

import math

import numpy as np
import pytest

from ..reference.side_by_side import MS, T0, SideBySide


def at(ms: float) -> int:
    return T0 + round(ms * MS)


def test_the_variance_of_a_steady_departure_is_that_of_its_distances():
    both = SideBySide(2, None)
    for k in range(5):
        both.observe(at(100 * k), {0: (0.0, 0.0), 1: (1.0 + 0.1 * k, 0.0)})
    variance, samples = both.variance([0, 1])
    assert samples[0, 1] == 5
    assert variance[0, 1] == pytest.approx(np.var([1.0, 1.1, 1.2, 1.3, 1.4]))


def test_a_late_observation_before_all_others_becomes_the_first():
    both = SideBySide(2, 0.1)
    for ms in (0, 100, 200, 300):
        both.observe(at(ms), {0: (0.0, 1e-3 * ms)})
    for ms in (150, 250):
        both.observe(at(ms), {1: (1.0, 0.0)})
    both.observe(at(50), {1: (1.4, 0.0)})
    both.check()
    assert both.samples(0, 1) == 5


def test_what_is_left_with_one_observation_cannot_be_compared_until_the_next():
    both = SideBySide(2, 0.1, span=600 * MS)
    for ms in range(0, 1400, 100):
        points = {0: (0.0, 0.0)}
        if ms in (0, 300, 600, 1200, 1300):
            points[1] = (1.0 + 1e-4 * ms, 0.0)
        both.observe(at(ms), points)
        both.evict(at(ms) - both.span)
        both.check()
        if ms == 1000:
            assert len(both.lists[1].times()) == 1
    assert both.samples(0, 1) == 2


@pytest.mark.parametrize("wild", [(0, 1000), (1000,)])
def test_a_wild_observation_leaves_no_trace_after_it_has_gone(wild):
    both = SideBySide(2, 0.1)
    rng = np.random.default_rng(0)
    for ms in range(0, 3000, 50):
        points = {k: np.array([k, 0.0]) + rng.normal(0, 1e-3, 2) for k in range(4)}
        if ms in wild:
            points[2] = np.array([3e30, -1e30])
        both.observe(at(ms), {k: tuple(x) for k, x in points.items()})
        both.evict(at(ms) - both.span)
        if ms in (1950, 2000, 2050, 2500):
            both.check()
    assert len(both.slots) == 4


def test_a_reused_slot_starts_empty():
    both = SideBySide(2, None)
    for ms in range(0, 1000, 100):
        both.observe(at(ms), {0: (0.0, 0.0), 1: (0.01 * ms, 0.0)})
    slot = both.slots[1]
    both.forget(1)
    both.observe(at(1000), {0: (0.0, 0.0), 2: (5.0, 0.0)})
    assert both.slots[2] == slot
    assert both.samples(0, 2) < 2
    both.observe(at(1100), {0: (0.0, 0.0), 2: (5.5, 0.0)})
    both.check()


@pytest.mark.parametrize("step", [0, 30])
def test_a_reused_slot_starts_empty_between_sources_out_of_step(step):
    both = SideBySide(2, None)
    for ms in range(0, 500, 100):
        both.observe(at(ms), {0: (0.0, 0.0)})
        both.observe(at(ms + step), {1: (0.01 * ms, 0.0)})
    slot = both.slots[1]
    both.forget(1)
    for ms in range(500, 800, 100):
        both.observe(at(ms), {0: (0.0, 0.0)})
        both.observe(at(ms + step), {2: (5.0 + 1e-3 * ms, 0.0)})
    assert both.slots[2] == slot
    both.check()


@pytest.mark.parametrize("step", [0, 30])
def test_small_motion_far_apart_keeps_its_digits(step):
    both = SideBySide(2, 0.1)
    for ms in range(0, 1000, 100):
        both.observe(at(ms), {0: (0.0, 0.0)})
        both.observe(at(ms + step), {1: (1e6 + 1e-3 * math.sin(ms), 0.0)})
    both.check()


def test_the_matrices_grow_with_the_window():
    both = SideBySide(3, 0.1)
    rng = np.random.default_rng(1)
    centres = rng.normal(0, 1, (70, 3))
    for k in range(4):
        count = 50 if k < 2 else 70
        points = centres[:count] + rng.normal(0, 0.01, (count, 3))
        both.observe(at(66 * k), {i: tuple(x) for i, x in enumerate(points)})
    both.check()


@pytest.mark.parametrize("v_move", [None, 0.1])
def test_single_precision_shows_in_no_affinity(v_move):
    rng = np.random.default_rng(0)
    both = SideBySide(3, v_move, dtype=np.float32)
    amplitude, pace, centre = rng.uniform(0, 0.5, (5, 3)), rng.uniform(0, 6, (5, 3)), rng.normal(0, 1, (5, 3))
    for ms in range(0, 2200, 10):
        x = centre + amplitude * np.sin(pace * ms * 1e-3) + rng.normal(0, 0.003, (5, 3))
        both.observe(at(ms), {k: tuple(x[k]) for k in range(5) if ms % (20, 30, 70, 100, 250)[k] == 0})
        if ms % 100 == 0:
            both.evict(at(ms) - both.span)
        if ms % 300 == 0:
            both.check_affinities(0.02)


def test_a_wild_observation_shows_in_no_affinity_after_it_has_gone():
    both = SideBySide(2, 0.1, dtype=np.float32)
    rng = np.random.default_rng(0)
    for ms in range(0, 3000, 50):
        points = {k: np.array([k, 0.0]) + rng.normal(0, 1e-3, 2) for k in range(4)}
        if ms in (0, 1000):
            points[2] = np.array([1e9, -1e9])
        both.observe(at(ms), {k: tuple(x) for k, x in points.items()})
        both.evict(at(ms) - both.span)
        if ms >= 1900 and ms % 100 == 0:
            both.check_affinities(0.02)
