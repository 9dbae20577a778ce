"""The compiled loops of the rigid method against plain NumPy, on random rows with gaps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comotion.rigid.costs import stacked
from comotion.rigid.kernels.differences import difference_covariances
from comotion.rigid.kernels.distances import distance_deviation, farthest_points
from comotion.rigid.kernels.paths import smooth_poses
from comotion.rigid.kernels.procrustes import fit_poses
from comotion.rigid.kernels.records import ROUND, Limits, Observations, PoseArrays, RowArrays
from comotion.rigid.kernels.resampling import resample
from comotion.rigid.kernels.residuals import body_costs
from comotion.rigid.kernels.rest import settle
from comotion.rigid.kernels.rotation import spatial_rotation
from comotion.rigid.offset_equations import normal_equations
from comotion.rigid.procrustes import Body, align
from comotion.rigid.slow_noise import variograms

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


def observations_of(rng, count):
    """Observations of some trajectories, one behind the other: times, positions [M, 3], start, stop."""
    counts = rng.integers(1, 30, count)
    stop = np.cumsum(counts)
    times = np.concatenate([np.cumsum(rng.choice([20, 30, 70, 400], n)) for n in counts]) * 1_000_000
    return Observations(times, rng.normal(size=(len(times), 3)), stop - counts, stop)


@given(st.integers(0, 10_000), st.integers(3, 8), st.booleans())
@settings(max_examples=40)
def test_spatial_rotation_is_the_best_one_wherever_it_starts(seed, n, started):
    rng = np.random.default_rng(seed)
    b, y = rng.normal(size=(2, n, 3))
    H = (y - y.mean(0)).T @ (b - b.mean(0))
    found = np.zeros((3, 3))
    near = Rotation.random(random_state=seed).as_matrix()
    spatial_rotation(H, near, started, found)
    expected, _ = Rotation.align_vectors(y - y.mean(0), b - b.mean(0))
    assert np.trace(found.T @ H) == pytest.approx(np.trace(expected.as_matrix().T @ H), rel=1e-9, abs=1e-9)
    assert np.linalg.det(found) == pytest.approx(1.0)


@few
@given(seeds, st.integers(4, 9), st.sampled_from([2, 3]))
def test_points_are_aligned_by_the_best_rotation(rng, count, dim):
    y, b = rng.normal(size=(2, count, 3))
    y[:, dim:] = b[:, dim:] = 0.0
    R, t = align(b, y, dim)
    turns = Rotation.from_rotvec([[0, 0, angle] for angle in np.linspace(0, 2 * np.pi, 400)])
    others = turns if dim == 2 else [Rotation.align_vectors(y - y.mean(0), b - b.mean(0))[0]]
    least = min(((y - y.mean(0) - one.apply(b - b.mean(0))) ** 2).sum() for one in others)
    # Points almost on a line leave the rotation almost open: compare what it minimises.
    assert ((y - b @ R.T - t) ** 2).sum() <= least * (1 + 1e-7) + 1e-12
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize("count", [1, 2])
def test_what_points_leave_open_is_the_rotation_that_is_near(count):
    b = np.eye(3)[:count]
    near = Rotation.from_rotvec([0.3, 0.0, 0.0])
    R, t = align(b, near.apply(b) + 1.0, 3, near.as_matrix())
    np.testing.assert_allclose(R, near.as_matrix(), atol=1e-5)
    np.testing.assert_allclose(t, 1.0, atol=1e-5)


@few
@given(seeds, st.integers(5, 8))
def test_poses_are_those_of_plain_procrustes(rng, count):
    y, w, tolerance = rows_of(rng, count, 12)
    truth = poses_of(rng, 12)
    y = np.einsum("fij,nfj->nfi", truth[0], y) + truth[1]
    b, t, posed = np.zeros((3, count)), np.zeros((12, 3)), np.zeros(12, bool)
    R = np.tile(np.eye(3), (12, 1, 1))
    rows = y.transpose(1, 2, 0).copy(), w.T.copy(), 1 / tolerance, metrics_of(count)
    fit_poses(*rows, 3, 4, b, PoseArrays(R, t, posed))
    expected = plain.fit_poses(y, w, tolerance, 4)
    for one, other in zip((b.T, R, t, posed), expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


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
    fit_poses(*rows, dim, 4, template, PoseArrays(R, t, posed))
    assert posed.all()
    np.testing.assert_allclose(R, np.tile(np.eye(3), (20, 1, 1)), atol=1e-6)


@few
@given(seeds, st.integers(0, 40), st.integers(2, 40))
def test_a_body_has_one_pose_for_each_rest(rng, moves_from, moves_for):
    _, w, noise = rows_of(rng, 6, 60)
    b, moving = rng.normal(size=(6, 3)), slice(moves_from, moves_from + moves_for)
    R, t = np.tile(np.eye(3), (60, 1, 1)), rng.normal(0, 4e-4, (60, 3))
    t[moving] += 0.05 * np.arange(60)[moving, None]
    t[moving.stop :] += t[min(moving.stop, 60) - 1]
    posed = rng.random(60) < 0.9
    expected = plain.settled(w, noise, b, 6, (R, t, posed))
    rests = np.zeros(60, bool)
    settle(w.T.copy(), 1 / noise, metrics_of(6), b.T.copy(), 3, 6, 8.0, PoseArrays(R, t, posed), rests)
    for one, other in zip((R, t, rests), expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    assert not rests[moving.start + 1 : moving.stop - 1].any()


@few
@given(
    seeds, st.sampled_from([2, 3]), st.sampled_from([1e-4, 1e-2, 1.0]), st.integers(0, 30), st.integers(0, 9)
)
def test_a_body_moves_on_the_most_likely_smooth_path(rng, dim, size, rest, frames):
    way = size * np.cumsum(np.cumsum(rng.normal(0, 0.1, (2, 40, 3)), 1), 1)
    turns, t = way + rng.normal(0, 0.01, (2, 40, 3))
    if dim == 2:
        turns[:, :2], t[:, 2] = 0.0, 0.0
    R, moving = Rotation.from_rotvec(turns).as_matrix(), np.ones(40, bool)
    moving[rest : rest + frames] = False
    terms = rng.normal(size=3), *rng.uniform(0.5e4, 2e4, (2, 40)), moving, dim
    expected = plain.smooth_poses(*terms, (R, t, moving))
    found = smooth_poses(*terms, PoseArrays(R, t, moving))
    for one, other in zip((R, t, *found), expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_a_uniform_motion_costs_a_line_and_a_jerky_one_far_more():
    rng = np.random.default_rng(0)
    noise, steady = rng.normal(0, 1e-3, (2, 60, 3)), np.outer(np.arange(60), [0.02, 0.0, 0.01])
    jerky = rng.normal(0, 0.1, (60, 3))
    found = {}
    for name, way, turns in (("steady", steady, noise[1]), ("jerky", steady + jerky, jerky)):
        t, R = way + noise[0], Rotation.from_rotvec(turns).as_matrix()
        terms = np.zeros(3), *np.full((2, 60), 1e6), np.ones(60, bool), 3
        found[name] = *smooth_poses(*terms, PoseArrays(R, t, np.ones(60, bool))), np.abs(t - way).mean()
    (free, few, error), (as_free, many, same) = found["steady"], found["jerky"]
    assert free == as_free == 2
    assert few < 10
    # Each of 60 poses has six degrees of freedom, of a hundredfold the noise: the log of a hundred.
    assert many > 0.5 * 60 * 6 * np.log(100)
    assert error < np.abs(noise[0]).mean() / 2
    assert same == pytest.approx(np.abs(noise[0]).mean(), rel=0.1)


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


@few
@given(seeds)
def test_the_variogram_of_distances_is_that_of_the_definition(rng):
    y, w = rng.normal(size=(2, 60, 3)), (rng.random((2, 60)) < 0.9).astype(float)
    d = np.where((w > 0).all(0), np.linalg.norm(y[0] - y[1], axis=1), np.nan)
    lags = np.array([1, 4, 30, 50])
    found = variograms(y, w, np.array([0]), np.array([1]), lags)[0]
    changes = [d[lag:] - d[:-lag] for lag in lags]
    changes = [one[np.isfinite(one)] for one in changes]
    expected = [(one**2).mean() / 2 if len(one) >= 8 else np.nan for one in changes]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@few
@given(seeds)
def test_normal_equations_are_those_of_the_definition(rng):
    y, w, tolerance = rows_of(rng, 3, 20, seen=0.7)
    poses, pivot = poses_of(rng, 20), rng.normal(size=3)
    seconds = np.cumsum(rng.uniform(0.03, 0.1, 20))
    rows, information = np.array([2, 0]), rng.normal(size=(20, 6, 6))
    information = information @ information.transpose(0, 2, 1) + 1e3 * np.eye(6)
    found = normal_equations(
        arrays_of(y, w, tolerance), seconds, rows, body_of(poses), information, pivot, 3, 3
    )
    used = [i for i in rows if ((w[i] > 0) & poses[2]).sum() >= 3]
    expected = plain.normal_equations(y[used], w[used], seconds, tolerance[used], poses, information, pivot)
    for one, other in zip(found[:3], expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5 * np.abs(other).max(initial=1))


def test_rows_that_are_hardly_seen_give_no_equations():
    rng = np.random.default_rng(0)
    y, w, tolerance = rows_of(rng, 3, 20, seen=0.0)
    body, information = body_of(poses_of(rng, 20)), np.tile(np.eye(6), (20, 1, 1))
    arrays, seconds = arrays_of(y, w, tolerance), np.arange(20) / 15
    found = normal_equations(arrays, seconds, np.arange(3), body, information, np.zeros(3), 3, 3)
    for one in found:
        np.testing.assert_array_equal(one, np.zeros_like(one))


@few
@given(seeds, st.integers(0, 40), st.sampled_from([np.inf, 1e-4]))
def test_resampling_is_that_of_the_plain_interpolation(rng, delay, variance):
    observations = observations_of(rng, 3)
    times, positions, start, stop = observations
    positions *= 0.01
    positions[rng.random(len(positions)) < 0.1] += rng.normal(size=3)
    stamps = np.unique(rng.choice(np.concatenate([times, times + 7_000_000]), 20))
    gap, hold, delays = np.array([[100], [30], [500]]).repeat(3, 1) * 1_000_000
    delays = np.full(3, delay * 1_000_000)
    y, w = np.zeros((3, len(stamps), 3)), np.zeros((3, len(stamps)))
    resample(observations, stamps, Limits(gap, hold, delays), np.full(3, variance), y, w)
    for i, (a, b) in enumerate(zip(start, stop, strict=True)):
        args = stamps, int(gap[i]), int(hold[i]), int(delays[i]), variance
        for one, other in zip((y[i], w[i]), plain.resample(times[a:b], positions[a:b], *args), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


@few
@given(seeds)
def test_noise_is_the_mean_third_difference_without_the_wild(rng):
    observations = observations_of(rng, 3)
    times, positions, start, stop = observations
    gap, directions = np.full(3, 100_000_000), np.array([[1.0, 0, 0], [0, 0.6, 0.8]])
    found, _ = difference_covariances(observations, gap, np.arange(3), directions, 1000)
    for i, (a, b) in enumerate(zip(start, stop, strict=True)):
        differences = plain.third_differences(times[a:b], positions[a:b], gap[i])
        squares = (differences @ directions.T) ** 2
        usual = (squares <= 9 / 0.45494 * np.median(squares, 0)).all(1) if len(squares) else []
        expected = differences[usual].T @ differences[usual] / max(np.sum(usual), 1) / 0.96
        np.testing.assert_allclose(found[i], expected, rtol=1e-6, atol=1e-300)


@few
@given(seeds)
def test_distances_are_those_of_the_definitions(rng):
    y, w, _ = rows_of(rng, 5, 10, seen=0.4)
    expected = plain.distance_deviation(y, w)
    np.testing.assert_allclose(distance_deviation(y, w), expected, rtol=1e-6, atol=1e-9)
    x = rng.normal(size=(12, 3))
    np.testing.assert_array_equal(farthest_points(x, 5), plain.farthest_points(x, 5))
