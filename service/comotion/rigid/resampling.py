"""Resamples trajectories of any rate and phase on common frames (step 3), with their tolerance (step 4)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Bools, Floats, Ints, Stamps, find, untouched_zeros
from ..config import RigidConfig
from ..geometry.frames import NOISE, Frames
from ..geometry.records import ROUND
from .kernels.differences import difference_covariances
from .kernels.records import Limits, Observations
from .kernels.resampling import mean_square, resample, spread
from .noise import NoiseEstimates, noise_covariances
from .slow_noise import SlowNoise, slow_noise
from .tracks import Tracks

# Length of an arm as a share of the scene's extent. Motion and noise of its end both grow with the length,
# so that the share hardly matters.
_ARM_LENGTH = 0.25
_ARMS = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [-1.0, -1.0, -1.0]])
# Names of rows: the key of the trajectory times this, plus the place among its rows.
_ROWS_PER_TRACK = 8
# Four points of three coordinates share the six degrees of freedom of one pose.
_ARM_WEIGHT = 0.5
# Shares by which a body deforms: of the rms displacement of a trajectory; of the extent of the scene at most;
# and of what the trajectories of the scene do, rms, at least.
_OF_MOTION, _OF_EXTENT, _OF_CONTACT = 0.01, 0.0015, 0.25
# Slack for the rounding of stamps and periods; far below any period.
_ROUNDING_NS = 2_000


@dataclass(frozen=True)
class _Curves:
    """Observations of points, or of the ends of one arm; `own` intp [n] are their trajectories."""

    on_arm: bool
    own: Ints
    observations: Observations


def make_frames(
    tracks: Tracks,
    estimates: NoiseEstimates,
    stamp_ns: int,
    span_ns: int,
    gap_ns: int,
    config: RigidConfig,
) -> Frames:
    """Interpolate every trajectory at frames that end at the watermark.

    Frames are tied to the watermark, not to any source: sources share no frames. Nothing is
    interpolated across a gap longer than `gap_ns` or three periods of the source. Beyond its newest
    observation a trajectory is extended by a period at most (plus the correction of its clock).

    Parameters
    ----------
    estimates
        Of the noise of the trajectories of the space.
    stamp_ns, span_ns
        The watermark, and the length of the window before it.
    """
    stamps = _stamps(tracks, stamp_ns, span_ns, config)
    limits = _limits(tracks, gap_ns, config)
    curves = _curves(tracks, tracks.extent)
    owner, weight, names = _owners(curves, tracks.key)
    covariance = _noise(tracks, estimates, curves, limits.gap)
    noise = _mean_variance(covariance, tracks.dim)
    y, w = _interpolated(tracks, curves, stamps, limits, noise)
    seen, squared = spread(y, w)
    life = np.zeros(len(tracks.key))
    np.maximum.at(life, owner, seen / config.frame_rate)
    deformation, resting = _deformation(squared, tracks.extent)
    covariance += deformation[:, None, None] * np.eye(3)
    tolerance, metric = _mean_variance(covariance, tracks.dim), _metrics(covariance, tracks.dim)
    tolerance, spectrum = _with_slow_noise(tracks, y, w, owner, tolerance, resting, config)
    terms = noise, tolerance, squared / tracks.dim, metric, spectrum
    per_track = tracks.key, life, tracks.current
    return Frames(config, tracks.dim, stamps, y, w, owner, weight, names, *terms, *per_track, tracks.extent)


def extended(frames: Frames, tracks: Tracks, stamps: Stamps, gap_ns: int) -> Frames:
    """The frames and newer ones, with rows of the trajectories that are new; these have noise as usual.

    Parameters
    ----------
    tracks
        The trajectories of the frames, then those that are new, of the same sources; observations before the
        newer frames may be left out.
    stamps
        int64 [n], ns, the newer frames.
    """
    curves = _curves(tracks, frames.extent)
    owner, weight, names = _owners(curves, tracks.key)
    variance = np.full(len(tracks.key), np.inf)
    variance[frames.owner] = frames.noise
    y, w = _interpolated(tracks, curves, stamps, _limits(tracks, gap_ns, frames.config), variance[owner])
    order, new = np.argsort(names), np.flatnonzero(owner >= len(frames.key))
    all_names = np.append(frames.names, names[new])
    at = find(all_names, names[order])
    usual = _usual_rows(frames, tracks.source, owner[new])
    room = _room(frames, np.where(at >= 0, order[at], -1), y, w)
    total, count = len(all_names), len(frames.stamps) + len(stamps)
    life = np.append(frames.life, np.zeros(len(tracks.key) - len(frames.key)))
    step = float(stamps[-1] - frames.stamps[-1]) * 1e-9 / len(stamps)
    np.maximum.at(seen := np.zeros(len(life), np.intp), owner, (w > 0).sum(1))
    alike: dict[str, Any] = {
        name: np.concatenate([getattr(frames, name), getattr(frames, name)[usual]]) for name in NOISE
    }
    return replace(
        frames,
        stamps=np.append(frames.stamps, stamps),
        y=room[0][:total, :count],
        w=room[1][:total, :count],
        owner=np.append(frames.owner, owner[new]),
        weight=np.append(frames.weight, weight[new]),
        names=all_names,
        key=tracks.key,
        life=life + step * seen,
        current=tracks.current,
        room=room,
        **alike,
    )


def _room(frames: Frames, origin: Ints, newer_y: Floats, newer_w: Floats) -> tuple[Floats, Floats]:
    """The rows of frames with newer frames, in memory for these or more.

    `origin` intp [P] is where each row is in the newer ones, [Q, n, 3] and [Q, n], or -1: unobserved there.
    """
    y, w = frames.room or (frames.y, frames.w)
    total, past = len(origin), len(frames.stamps)
    count = past + newer_w.shape[1]
    if total > len(w) or count > w.shape[1]:
        shape = total + total // 4, count + count // 2
        y, w = untouched_zeros((*shape, 3), np.float64), untouched_zeros(shape, np.float64)
        y[: len(frames.y), :past], w[: len(frames.y), :past] = frames.y, frames.w
    # Newer frames that were given up may have been there.
    origin = np.append(origin, np.full(len(w) - total, -1))
    for values, newer in ((y, newer_y), (w, newer_w)):
        unobserved = np.zeros((1, *newer.shape[1:]))
        values[:, past:count] = np.concatenate([newer, unobserved]).take(origin, 0)
    return y, w


def _usual_rows(frames: Frames, sources: Ints, wanted: Ints) -> Ints:
    """A row of usual noise of the source of each wanted trajectory, intp [n]."""
    usual = np.zeros(len(wanted), np.intp)
    for source in np.unique(sources[wanted]).tolist():
        rows = np.flatnonzero(sources[frames.owner] == source)
        usual[sources[wanted] == source] = rows[np.argsort(frames.tolerance[rows])[len(rows) // 2]]
    return usual


def _owners(curves: list[_Curves], key: Stamps) -> tuple[Ints, Floats, Stamps]:
    """Trajectory of each row, intp [P], by their keys int64 [N]; weight, float64 [P], and name, int64 [P]."""
    owner = np.concatenate([c.own for c in curves])
    weight = [np.full(len(c.own), _ARM_WEIGHT if c.on_arm else 1.0) for c in curves]
    # The first arm has the name of a point: a feature may come to be a 6-DoF one.
    places = np.repeat(np.maximum(np.arange(len(curves)) - 1, 0), [len(c.own) for c in curves])
    return owner, np.concatenate(weight), key[owner] * _ROWS_PER_TRACK + places


def _mean_variance(covariance: Floats, dim: int) -> Floats:
    """Variance of a coordinate on average, [P], of covariances [P, 3, 3]."""
    return np.asarray(np.trace(covariance[:, :dim, :dim], axis1=1, axis2=2) / dim)


def _metrics(covariance: Floats, dim: int) -> Floats:
    """Inverse covariances in units of the inverse mean variance, [P, 6]."""
    metrics = np.tile(ROUND, (len(covariance), 1))
    rows = (covariance != covariance[:, :1, :1] * np.eye(3)).any((1, 2))
    inverse = np.linalg.inv(covariance[rows]) * _mean_variance(covariance[rows], dim)[:, None, None]
    metrics[rows] = inverse[:, *np.triu_indices(3)]
    return metrics


def _with_slow_noise(
    tracks: Tracks,
    y: Floats,
    w: Floats,
    owner: Ints,
    tolerance: Floats,
    resting: Bools,
    config: RigidConfig,
) -> tuple[Floats, Floats]:
    """Tolerance with the slow noise of each source, [P], and its spectrum, [P, 3].

    Rows at rest, bool [P] `resting`, may show more of it: the tolerance of moving rows is mostly deformation.
    """
    wider, spectrum = tolerance.copy(), np.tile([1.0, 0.0, 0.0], (len(owner), 1))
    sources = tracks.source[owner]
    for source in np.unique(sources).tolist():
        usual = SlowNoise()
        for members in sources == source, (sources == source) & resting:
            rows = np.flatnonzero(members & tracks.current[owner])
            noise = slow_noise(y, w, tolerance, rows, config.frame_rate)
            if noise.factor(w.shape[1]) > usual.factor(w.shape[1]):
                usual, factor = noise, noise.factor(w.shape[1])
                wider[members] = tolerance[members] * factor
                spectrum[members] = noise.white / factor, noise.slow / factor, noise.persistence
    return wider, spectrum


def _stamps(tracks: Tracks, stamp_ns: int, span_ns: int, config: RigidConfig) -> Stamps:
    """Times of the frames: the whole window, without the part before the first observation; at least one."""
    step = round(1e9 / config.frame_rate)
    count = max(int(span_ns // step), 2)
    stamps = stamp_ns - step * np.arange(count - 1, -1, -1, dtype=np.int64)
    first_ns = (tracks.times[tracks.start] + tracks.delay_ns).min()
    stamps = stamps[np.searchsorted(stamps, first_ns) :]
    return stamps if len(stamps) else np.array([stamp_ns], np.int64)


def _limits(tracks: Tracks, gap_ns: int, config: RigidConfig) -> Limits:
    step = round(1e9 / config.frame_rate)
    period_ns = (tracks.period * 1e9).astype(np.int64)
    hold = np.minimum(step, period_ns) + np.minimum(np.abs(tracks.delay_ns), step) + _ROUNDING_NS
    return Limits(np.maximum(gap_ns, 3 * period_ns), hold, tracks.delay_ns)


def _interpolated(
    tracks: Tracks, curves: list[_Curves], stamps: Stamps, limits: Limits, variance: Floats
) -> tuple[Floats, Floats]:
    """Positions [P, F, 3] and weights [P, F] of all rows, of which float64 [P] is the noise."""
    total = sum(len(c.own) for c in curves)
    y, w = np.zeros((total, len(stamps), 3)), np.zeros((total, len(stamps)))
    first, corrected = 0, (tracks.shift != 0).any(1) | (tracks.turn != np.eye(3)).any((1, 2))
    for c in curves:
        rows, own = slice(first, first + len(c.own)), c.own
        first = rows.stop
        own_limits = Limits(limits.gap[own], limits.hold[own], limits.delay[own])
        resample(c.observations, stamps, own_limits, variance[rows], y[rows], w[rows])
        if corrected.any():
            corrected_rows = np.flatnonzero(corrected[own])
            turned = np.einsum("nfi,nji->nfj", y[rows][corrected_rows], tracks.turn[own[corrected_rows]])
            seen = w[rows][corrected_rows, :, None] > 0
            y[rows][corrected_rows] = turned + tracks.shift[own[corrected_rows], None] * seen
    return y, w


def _noise(tracks: Tracks, estimates: NoiseEstimates, curves: list[_Curves], gap: Stamps) -> Floats:
    """Covariance of the noise of all rows, float64 [P, 3, 3]."""
    estimate, count = estimates.read(tracks, gap)
    covariances = []
    for c in curves:
        terms = estimate[c.own], count[c.own]
        if c.on_arm:
            terms = difference_covariances(c.observations, gap[c.own], np.arange(len(c.own)))
        covariances.append(noise_covariances(tracks, *terms, c.own, on_arm=c.on_arm))
    return np.concatenate(covariances)


def _curves(tracks: Tracks, extent: float) -> list[_Curves]:
    """Points first, then the ends of the arms of 6-DoF features, arm by arm."""
    six = np.zeros(len(tracks.key), np.bool_)
    if tracks.quaternions is not None and tracks.dim == 3:
        first = np.ascontiguousarray(tracks.quaternions[:, 0])
        six = np.isfinite(mean_square(first, tracks.start, tracks.stop))
    own = np.flatnonzero(~six)
    observations = Observations(tracks.times, tracks.positions, tracks.start[own], tracks.stop[own])
    points = _Curves(False, own, observations)
    return [points, *_arms(tracks, np.flatnonzero(six), extent)] if six.any() else [points]


def _arms(tracks: Tracks, own: Ints, extent: float) -> list[_Curves]:
    """Ends of the arms of 6-DoF features `own` intp [n]."""
    assert tracks.quaternions is not None  # noqa: S101 - they have orientations
    spans = [np.arange(tracks.start[i], tracks.stop[i]) for i in own.tolist()]
    observed, counts = np.concatenate(spans), tracks.stop[own] - tracks.start[own]
    stop, times = np.cumsum(counts), tracks.times[observed]
    orientations, positions = Rotation.from_quat(tracks.quaternions[observed]), tracks.positions[observed]
    ends = [positions + orientations.apply(arm) for arm in _ARMS * _ARM_LENGTH * extent]
    return [_Curves(True, own, Observations(times, end, stop - counts, stop)) for end in ends]


def _deformation(squared: Floats, extent: float) -> tuple[Floats, Bools]:
    """Variance that the deformation of a body adds to a coordinate, [P], and whether it is that of contact.

    Real bodies bend and skin slides, in proportion to their motion (`squared` [P], the mean squared
    displacement) and up to a share of the scene's extent. Bodies that hardly move are deformed by contact
    with moving ones: by a share of the root mean square of all.
    """
    slack = np.minimum(_OF_EXTENT * extent, _OF_MOTION * np.sqrt(squared))
    usual = float(np.sqrt(np.mean(slack**2))) if len(slack) else 0.0
    resting = slack < _OF_CONTACT * usual
    slack = np.maximum(slack, _OF_CONTACT * usual)
    # Two points of a body deform, and so do both of their means: 4 slack^2, as in the distance of a pair.
    return np.asarray(4 * slack**2), np.asarray(resting)
