"""Trajectories of any rate and phase on common frames, with the noise and the tolerance of each."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..window import Bools, Floats, Stamps
from .config import MotionConfig
from .noise import noise_variance
from .sampling import resample
from .tracks import Ints, Tracks

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

    def per_track(self, values: Floats) -> Floats:
        """Weighted sum of a row quantity over each trajectory's rows, float64 [N]."""
        return np.bincount(self.owner, values * self.weight, len(self.life)).astype(np.float64)


def make_frames(
    tracks: Tracks, stamp_ns: int, span_ns: int, gap_ns: int, lag_ns: Ints | Stamps, config: MotionConfig
) -> Frames:
    """Interpolate every trajectory at frames that end at the watermark.

    Frames are tied to the watermark, not to any source: sources share no frames. Nothing is
    interpolated across a gap longer than `gap_ns` or three periods of the source; past its newest
    observation a trajectory is extended by a period at most (plus `lag_ns` [N], a corrected clock).
    """
    step = round(1e9 / config.frame_rate)
    count = max(int(span_ns // step), 2)
    stamps = stamp_ns - step * np.arange(count - 1, -1, -1, dtype=np.int64)
    stamps = stamps[np.searchsorted(stamps, tracks.times.min()) :] if len(tracks.times) else stamps
    stamps = stamps if len(stamps) else np.array([stamp_ns], np.int64)
    period_ns = (tracks.period * 1e9).astype(np.int64)
    gap = np.maximum(gap_ns, 3 * period_ns)
    hold = np.minimum(step, period_ns) + lag_ns + _ROUNDING_NS
    points, owner, weight = _rows(tracks)
    y = np.zeros((len(owner), len(stamps), 3))
    w = np.zeros((len(owner), len(stamps)))
    noise = np.zeros(len(owner))
    for on_arm, positions, rows in points:
        own = owner[rows]
        part = np.zeros((len(own), len(stamps), 3)), np.zeros((len(own), len(stamps)))
        resample(
            tracks.times, positions, tracks.start[own], tracks.stop[own], stamps, gap[own], hold[own], *part
        )
        y[rows], w[rows] = part
        noise[rows] = noise_variance(tracks, positions, own, gap[own], config.noise_pool, on_arm=on_arm)
    life = np.zeros(len(tracks.key), np.intp)
    np.maximum.at(life, owner, (w > 0).sum(1))
    return Frames(
        dim=tracks.dim,
        stamps=stamps,
        y=y,
        w=w,
        owner=owner,
        weight=weight,
        noise=noise,
        tolerance=noise + _deformation(y, w, tracks.extent(), config),
        life=life,
        alive=tracks.alive,
    )


def _rows(tracks: Tracks) -> tuple[list[tuple[bool, Floats, Ints]], Ints, Floats]:
    """(whether at an arm's end, positions [M, dim], rows), the trajectory of each row, and its weight."""
    count = len(tracks.key)
    turns = tracks.quaternions
    if turns is None or tracks.dim != 3:
        return [(False, tracks.positions, np.arange(count))], np.arange(count), np.ones(count)
    known = np.asarray(np.isfinite(turns).all(axis=1), np.bool_)
    posed = np.asarray(np.logical_and.reduceat(known, tracks.start), np.bool_)
    turning = Rotation.from_quat(np.where(known[:, None], turns, [0.0, 0, 0, 1]))
    plain, six = np.flatnonzero(~posed), np.flatnonzero(posed)
    points: list[tuple[bool, Floats, Ints]] = [(False, tracks.positions, np.arange(len(plain)))]
    owner = [plain]
    for k, arm in enumerate(_ARMS * _ARM * tracks.extent()):
        points.append(
            (True, tracks.positions + turning.apply(arm), len(plain) + k * len(six) + np.arange(len(six)))
        )
        owner.append(six)
    weight = np.concatenate([np.ones(len(plain)), np.full(len(_ARMS) * len(six), _ARM_WEIGHT)])
    return points, np.concatenate(owner), weight


def _deformation(y: Floats, w: Floats, extent: float, config: MotionConfig) -> Floats:
    """Variance that a body's not being perfectly rigid adds to a coordinate, float64 [P].

    Real bodies bend and skin slides, in proportion to how they move and up to a share of their size;
    what does not move does not bend.
    """
    seen = w > 0
    count = np.maximum(seen.sum(1), 1)
    mean = (y * seen[:, :, None]).sum(1) / count[:, None]
    squared = (((y - mean[:, None]) ** 2).sum(2) * seen).sum(1) / count
    slack = np.minimum(config.rigidity_extent * extent, config.rigidity_motion * np.sqrt(squared))
    # Two points of a body that each deform, and both their means: 4 slack^2 as in a pair's distance.
    return np.asarray(4 * slack**2)
