"""Rows of trajectories on common frames: the input of steps 4 to 10 of the method."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Ints, Stamps
from ..config import RigidConfig
from .records import RowArrays

LONG_LIFE = 0.5
"""s of observation from which on an ended trajectory counts, and any shows the offset of its source."""
SETTLED = 1.0
"""s of observation, or of evidence, after which it counts in full."""
FEWEST = 8
"""Fewest frames that are compared."""
FEW = 3
"""Features, or samples, that show what they have in common."""
DRAWN = 128
"""Most points, evenly drawn, that stand for all: a bound of the work in large scenes. Chosen on made-up
crowds of thousands of features."""
ENOUGH = 64
"""Most rows, in a large scene, that a body is fitted to, or that the slow noise of a source is read from."""
SELDOM = 0.3
"""Share of the window after which what was confirmed is sought anew."""
RENEWED = 0.1
"""Share of the window, or of trajectories that are new, after which what was found is sought anew."""
NOISE = ("noise", "tolerance", "moved", "metric", "spectrum")
"""Attributes of :class:`Frames` that describe the noise and the motion of a row."""
PER_ROW = ("weight", "names", *NOISE)


@dataclass(frozen=True)
class Frames:
    """P rows on F frames, of which the last is at the watermark.

    A point is one row. A 6-DoF feature is four rows, the ends of four arms that are fixed to it, so that its
    orientation counts like the motion of points; its four rows share the weight of their one pose.

    Attributes
    ----------
    config
        Parameters of the method.
    dim
        2 or 3.
    stamps
        int64 [F], ns, ascending.
    y
        float64 [P, F, 3], positions, zero in the third coordinate in 2-D.
    w
        float64 [P, F], inverse variance relative to that of one observation; 0 where unobserved.
    owner, weight, names
        intp [P], trajectory of a row; float64 [P], weight of a frame of the row in the cost of
        its trajectory; int64 [P], stable names of the rows.
    noise, tolerance
        float64 [P] each, variance of a coordinate of an observation, without and with the body's deformation
        and slow noise.
    moved
        float64 [P], mean squared distance of a coordinate from its mean.
    metric
        float64 [P, 6], by how much each direction counts, of :class:`~.records.RowArrays`.
    spectrum
        float64 [P, 3], white and slow part of the noise, in tolerances, and the correlation of the slow part
        from frame to frame.
    key
        int64 [N], stable number of each trajectory, ascending.
    life
        float64 [N], s, for how long a trajectory is observed.
    current
        bool [N], whether a trajectory goes on at the watermark.
    extent
        Scale of the scene, in its unit, when the frames were made.
    room
        None, or the arrays of which `y` and `w` are the beginnings, with memory for newer rows and frames.
    """

    config: RigidConfig
    dim: int
    stamps: Stamps
    y: Floats
    w: Floats
    owner: Ints
    weight: Floats
    names: Stamps
    noise: Floats
    tolerance: Floats
    moved: Floats
    metric: Floats
    spectrum: Floats
    key: Stamps
    life: Floats
    current: Bools
    extent: float = 1.0
    room: tuple[Floats, Floats] | None = None

    @property
    def step(self) -> float:
        """Time from frame to frame in the mean, s; 0 for a single one."""
        return float(self.stamps[-1] - self.stamps[0]) * 1e-9 / max(len(self.stamps) - 1, 1)

    @property
    def informative(self) -> Bools:
        """Which trajectories show how a body moves, bool [N]: the current ones, and long-lived ended ones."""
        return self.current | (self.life >= LONG_LIFE)

    @property
    def arrays(self) -> RowArrays:
        """The rows as arguments of kernels."""
        return RowArrays(self.y, self.w, self.tolerance, self.spectrum, self.metric)

    def independent(self, rows: Ints) -> Floats:
        """Share of the frames that are independent samples of the noise of rows intp [m], float64 [m].

        Of frames with autocorrelation rho_k at lag k, one in 1 + 2 sum_k rho_k^2 is.
        """
        white, _, persistence = self.spectrum[rows].T
        time = np.minimum(-1 / np.log(np.clip(persistence, 1e-9, 1 - 1e-9)), len(self.stamps) / 3)
        return np.asarray(1 / (1 + np.maximum(1 - white, 0.0) ** 2 * time))

    def rows_of(self, tracks: Ints | Bools) -> Ints:
        """Rows of trajectories given by index intp [n] or mask bool [N], ascending."""
        chosen = np.zeros(len(self.life), np.bool_)
        chosen[tracks] = True
        return np.flatnonzero(chosen[self.owner])

    def of(self, tracks: Ints) -> "Frames":
        """The frames of some trajectories only, intp [n] ascending."""
        rows = self.rows_of(tracks)
        columns: dict[str, Any] = {name: getattr(self, name)[rows] for name in ("y", "w", *PER_ROW)}
        columns |= {name: getattr(self, name)[tracks] for name in ("key", "life", "current")}
        return replace(self, owner=np.searchsorted(tracks, self.owner[rows]), room=None, **columns)

    def per_track(self, values: Floats) -> Floats:
        """Weighted sum of `values` float64 [P] over the rows of each trajectory, float64 [N]."""
        return np.bincount(self.owner, values * self.weight, len(self.life)).astype(np.float64)
