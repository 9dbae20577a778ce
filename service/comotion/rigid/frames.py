"""Trajectories of any rate and phase on common frames, with the noise and the tolerance of each."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..arrays import Bools, Floats, Ints, Stamps
from ..config import RigidConfig
from .noise import READ, Differences, noise_variance
from .sampling import all_known, difference_noise, move, resample, scatter
from .tracks import Tracks, ranges

# An orientation is carried by points on arms of this share of the scene: far enough to tell turning
# from noise; its noise grows with the arm alike, so the share hardly matters.
_ARM = 0.25
_ARMS = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [-1.0, -1.0, -1.0]])
# Four points of three coordinates share the six degrees of freedom of one pose.
_ARM_WEIGHT = 0.5
_ROUNDING_NS = 2_000


@dataclass(frozen=True)
class Frames:
    """Rows on F frames, the last at the watermark; a point is one row, a 6-DoF feature four.

    Attributes
    ----------
    dim
        2 or 3.
    stamps
        int64 [F], ns, ascending.
    y
        float64 [P, F, 3], zero in the third coordinate in 2-D.
    w
        float64 [P, F], inverse variance relative to one observation; 0 where unobserved.
    owner, weight
        intp [P] trajectory of a row; float64 [P] weight of the row in the trajectory's cost.
    noise, tolerance
        float64 [P], variance of a coordinate: of the observation, and with the body's deformation.
    life
        intp [N], frames in which a trajectory is observed.
    alive
        bool [N].
    """

    dim: int
    stamps: Stamps
    y: Floats
    w: Floats
    owner: Ints
    weight: Floats
    noise: Floats
    tolerance: Floats
    life: NDArray[np.intp]
    alive: Bools

    def rows_of(self, tracks: Ints | Bools) -> Ints:
        """Rows of trajectories given by index or mask."""
        chosen = np.zeros(len(self.life), np.bool_)
        chosen[tracks] = True
        return np.flatnonzero(chosen[self.owner])

    def of(self, tracks: Ints) -> "Frames":
        """Those of some trajectories, intp [n] ascending."""
        rows = self.rows_of(tracks)
        return replace(
            self,
            y=self.y[rows],
            w=self.w[rows],
            owner=np.searchsorted(tracks, self.owner[rows]),
            weight=self.weight[rows],
            noise=self.noise[rows],
            tolerance=self.tolerance[rows],
            life=self.life[tracks],
            alive=self.alive[tracks],
        )

    def thinned(self, stride: int) -> "Frames":
        """Every stride-th frame, counted back from the newest."""
        kept = np.arange(len(self.stamps) - 1, -1, -stride)[::-1]
        return replace(
            self,
            stamps=self.stamps[kept],
            y=np.ascontiguousarray(self.y[:, kept]),
            w=np.ascontiguousarray(self.w[:, kept]),
        )

    def per_track(self, values: Floats) -> Floats:
        """Weighted sum of a row quantity over each trajectory's rows, float64 [N]."""
        return np.bincount(self.owner, values * self.weight, len(self.life)).astype(np.float64)


@dataclass(frozen=True)
class Curves:
    """Rows of one kind: the trajectories themselves, or one arm of each 6-DoF one.

    `own` intp [n] says whose they are; observations of the k-th are [start[k]:stop[k]] of `times` and
    `positions`, whose noise is summed up by `squared` and `count` (see
    :func:`~comotion.rigid.noise.noise_variance`).
    """

    on_arm: bool
    own: Ints
    times: Stamps
    positions: Floats
    start: Ints
    stop: Ints
    squared: Floats
    count: Ints


def make_frames(
    tracks: Tracks,
    differences: Differences,
    stamp_ns: int,
    span_ns: int,
    gap_ns: int,
    config: RigidConfig,
) -> Frames:
    """Interpolate every trajectory at frames that end at the watermark.

    Frames are tied to the watermark, not to any source: sources share no frames. Nothing is
    interpolated across a gap longer than `gap_ns` or three periods of the source; past its newest
    observation a trajectory is extended by a period at most (plus the correction of its clock).
    """
    step = round(1e9 / config.frame_rate)
    count = max(int(span_ns // step), 2)
    stamps = stamp_ns - step * np.arange(count - 1, -1, -1, dtype=np.int64)
    first_ns = (tracks.times[tracks.start] + tracks.delay_ns).min()
    stamps = stamps[np.searchsorted(stamps, first_ns) :]
    stamps = stamps if len(stamps) else np.array([stamp_ns], np.int64)
    period_ns = (tracks.period * 1e9).astype(np.int64)
    gap = np.maximum(gap_ns, 3 * period_ns)
    hold = np.minimum(step, period_ns) + np.abs(tracks.delay_ns) + _ROUNDING_NS
    parts = _curves(tracks, differences, gap)
    owner = np.concatenate([part.own for part in parts])
    y, w = np.zeros((len(owner), len(stamps), 3)), np.zeros((len(owner), len(stamps)))
    noise, seen, squared = np.zeros(len(owner)), np.zeros(len(owner), np.intp), np.zeros(len(owner))
    first, corrected = 0, tracks.corrected
    for c in parts:
        rows, own = slice(first, first + len(c.own)), c.own
        first = rows.stop
        delay = tracks.delay_ns[own]
        resample(c.times, c.positions, c.start, c.stop, stamps, gap[own], hold[own], delay, y[rows], w[rows])
        if not c.on_arm and corrected.any():
            move(y[rows], w[rows], tracks.turn[own], tracks.shift[own], corrected[own])
        noise[rows] = noise_variance(tracks, c.squared, c.count, own, config.noise_pool, on_arm=c.on_arm)
    scatter(y, w, seen, squared)
    life = np.zeros(len(tracks.key), np.intp)
    np.maximum.at(life, owner, seen)
    weight = np.concatenate([np.full(len(c.own), _ARM_WEIGHT if c.on_arm else 1.0) for c in parts])
    return Frames(
        dim=tracks.dim,
        stamps=stamps,
        y=y,
        w=w,
        owner=owner,
        weight=weight,
        noise=noise,
        tolerance=noise + _deformation(squared, tracks.extent(), config),
        life=life,
        alive=tracks.alive,
    )


def _curves(tracks: Tracks, differences: Differences, gap: Stamps) -> list[Curves]:
    """Points first, then the ends of the arms of what has an orientation, arm by arm."""
    squared, count = differences.read(tracks, gap)
    six = np.zeros(len(tracks.key), np.bool_)
    if tracks.quaternions is not None and tracks.dim == 3:
        six = all_known(tracks.quaternions, tracks.start, tracks.stop)
    own = np.flatnonzero(~six)
    start, stop = tracks.start[own], tracks.stop[own]
    plain = Curves(False, own, tracks.times, tracks.positions, start, stop, squared[own], count[own])
    return [plain, *_arms(tracks, np.flatnonzero(six), gap)] if six.any() else [plain]


def _arms(tracks: Tracks, own: Ints, gap: Stamps) -> list[Curves]:
    assert tracks.quaternions is not None  # noqa: S101 - they have orientations
    observed = ranges(tracks.start[own], tracks.stop[own])
    counts = tracks.stop[own] - tracks.start[own]
    of = np.repeat(own, counts)
    stop = np.cumsum(counts)
    start, times = stop - counts, tracks.times[observed]
    turning = Rotation.from_quat(tracks.quaternions[observed])
    places = tracks.positions[observed]
    if tracks.corrected[own].any():
        turning = Rotation.from_matrix(tracks.turn[of]) * turning
        places = np.einsum("nij,nj->ni", tracks.turn[of], places) + tracks.shift[of]
    found = []
    for arm in _ARMS * _ARM * tracks.extent():
        ends = places + turning.apply(arm)
        squared, count = difference_noise(times, ends, start, stop, gap[own], READ)
        found.append(Curves(True, own, times, ends, start, stop, squared, count))
    return found


def _deformation(squared: Floats, extent: float, config: RigidConfig) -> Floats:
    """Variance that a body's not being perfectly rigid adds to a coordinate, float64 [P].

    Real bodies bend and skin slides, in proportion to how they move (`squared` [P], the mean squared
    displacement) and up to a share of their size; what does not move does not bend.
    """
    slack = np.minimum(config.rigidity_extent * extent, config.rigidity_motion * np.sqrt(squared))
    # Two points of a body that each deform, and both their means: 4 slack^2 as in a pair's distance.
    return np.asarray(4 * slack**2)
