"""Compiled code against readable twins: rigid bodies, those in tests/reference, and interpolation."""

from bisect import bisect_right

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comotion.geometry.body import Body, align, stacked
from comotion.geometry.procrustes import fit_poses
from comotion.geometry.records import ROUND, PoseArrays, RowArrays
from comotion.geometry.residuals import body_costs
from comotion.trajectories.window import Window

from ..reference import rigid as plain

seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)
few = settings(max_examples=25)
TOLERANCE = 1e-6
WHITE = 1.0, 0.0, 0.0
SLOW = 0.3, 5.0, 0.99
# Metric of noise that is five times as large along an oblique line as across it.
LONG = 1.6, -1.2, 0.8, 2.4, 0.5, 2.9


def rows_of(rng, count, frames, seen=0.8):
    """Rows [count, F, 3] that hardly move, weights with gaps [count, F], tolerances [count]."""
    y = rng.normal(size=(count, 1, 3)) + rng.normal(0, 2e-3, (count, frames, 3))
    w = rng.uniform(0.5, 2.0, (count, frames)) * (rng.random((count, frames)) < seen)
    return y, w, rng.uniform(0.5, 2.0, count) * TOLERANCE


def arrays_of(y, w, tolerance, spectrum=WHITE, metric=ROUND):
    """Rows with one noise spectrum for all."""
    return RowArrays(y, w, tolerance, np.tile(spectrum, (len(y), 1)), metrics_of(len(y), metric))


def metrics_of(count, metric=ROUND):
    """One metric for all."""
    return np.tile(metric, (count, 1))


def poses_of(rng, frames):
    """Small motion about the origin: R [F, 3, 3], t [F, 3], posed [F], the last frame posed."""
    R = Rotation.from_rotvec(np.cumsum(rng.normal(0, 1e-3, (frames, 3)), 0)).as_matrix()
    posed = rng.random(frames) < 0.8
    posed[-1] = True
    return PoseArrays(R, np.cumsum(rng.normal(0, 1e-3, (frames, 3)), 0), posed)


def body_of(poses):
    """A body that was fitted to nothing."""
    return Body(np.zeros(0, int), np.zeros((0, 3)), *poses, 6)


@few
@given(seeds, st.integers(4, 9), st.sampled_from([2, 3]))
def test_points_are_aligned_by_the_best_rotation(rng, count, dim):
    y, b = rng.normal(size=(2, count, 3))
    y[:, dim:] = b[:, dim:] = 0.0
    turns = Rotation.from_rotvec([[0, 0, angle] for angle in np.linspace(0, 2 * np.pi, 400)])
    others = turns if dim == 2 else [Rotation.align_vectors(y - y.mean(0), b - b.mean(0))[0]]
    costs = [((y - y.mean(0) - one.apply(b - b.mean(0))) ** 2).sum() for one in others]
    # It is slightly pulled towards the rotation that is near.
    for near, slack in ((others[int(np.argmin(costs))].as_matrix(), 1e-7), (np.eye(3), 1e-2)):
        R, t = align(b, y, dim, near)
        # Points almost on a line leave the rotation almost open: compare what it minimises.
        assert ((y - b @ R.T - t) ** 2).sum() <= min(costs) * (1 + slack) + slack**2
        assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize("count", [1, 2])
def test_what_points_leave_open_is_the_rotation_that_is_near(count):
    b = np.eye(3)[:count]
    near = Rotation.from_rotvec([0.3, 0.0, 0.0])
    R, t = align(b, near.apply(b) + 1.0, 3, near.as_matrix())
    np.testing.assert_allclose(R, near.as_matrix(), atol=1e-5)
    np.testing.assert_allclose(t, 1.0, atol=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_one_feature_that_is_left_carries_a_body_over_as_it_was_turned(dim):
    rng = np.random.default_rng(0)
    b, way = rng.normal(size=(9, 3)), np.outer(np.arange(20), [0.1, 0.2, 0.0])
    b[:, dim:] = 0.0
    y, w = b[:, None] + way, np.ones((9, 20))
    # All but the first are others from the tenth frame on.
    w[1:4, 10:] = w[4:, :10] = 0.0
    template, R, t, posed = np.zeros((3, 9)), np.zeros((20, 3, 3)), np.zeros((20, 3)), np.zeros(20, bool)
    rows = y.transpose(1, 2, 0).copy(), w.T.copy(), np.full(9, 1e6), metrics_of(9)
    fit_poses(*rows, dim, np.eye(3), 4, False, template, PoseArrays(R, t, posed))
    assert posed.all()
    np.testing.assert_allclose(R, np.tile(np.eye(3), (20, 1, 1)), atol=1e-6)


@few
@given(seeds, st.integers(1, 4), st.sampled_from([WHITE, SLOW]), st.sampled_from([ROUND, LONG]))
def test_costs_are_those_of_the_definition(rng, bodies, spectrum, metric):
    y, w, tolerance = rows_of(rng, 6, 20)
    moves = [poses_of(rng, 20) for _ in range(bodies)]
    rows, unposed = np.array([4, 0, 5]), rng.uniform(3, 50)
    soft = rng.choice([0.0, 0.3, 9.0], bodies) * TOLERANCE, 0.9
    cost, squared = np.full((2, 3, bodies), np.nan)
    terms = soft, unposed, 3, 16.0, cost, squared
    body_costs(arrays_of(y, w, tolerance, spectrum, metric), rows, stacked(list(map(body_of, moves))), *terms)
    for n, i in enumerate(rows):
        for k, poses in enumerate(moves):
            terms = (soft[0][k], soft[1]), 16.0, unposed, spectrum, metric
            expected = plain.row_cost(y[i], w[i], tolerance[i], poses, *terms)
            assert (cost[n, k], squared[n, k]) == pytest.approx(expected, rel=1e-9)


times = st.lists(st.integers(0, 60), max_size=20, unique=True).map(sorted)
stamps = st.lists(st.integers(-5, 80), min_size=1, max_size=12).map(sorted)


@settings(max_examples=50)
@given(series=st.lists(times.filter(len), min_size=1, max_size=4), stamps=stamps, gap=st.integers(1, 20))
def test_states_are_those_of_the_segments(series, stamps, gap):
    window = Window(2, 10**9, gap)
    slots = window.open(len(series), 0)
    for slot, times in zip(slots, series, strict=True):
        for t in times:
            window.insert(slot[None], t, np.array([[t * t, -t]], float), np.array([np.nan]), None)
    states = window.states_at(slots, np.array(stamps))
    for n, times in enumerate(series):
        for t, stamp in enumerate(stamps):
            newest, observed = bisect_right(times, stamp) - 1, stamp in times
            inside = 0 <= newest < len(times) - 1 and times[newest + 1] - times[newest] <= gap
            assert (states.observed[t, n], states.held[t, n]) == (observed, observed or inside)
            if observed or inside:
                expected = [np.interp(stamp, times, np.square(times)), -stamp]
                np.testing.assert_allclose(states.position[t, n], expected, rtol=1e-12, atol=1e-12)
