"""The window in; how far trajectories have moved over several time scales, and their noise, out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window

SCALES_NS = (100_000_000, 250_000_000, 1_000_000_000, 3_000_000_000)
"""ns; over which motion is looked at: a hand moves within the first two, a slow drawer within the others."""

# Newest instants on which noise is estimated, and differences that the median of the source is worth.
_NOISE_INSTANTS, _POOL = 12, 20
# Median of a chi-squared variable with two degrees of freedom, per coordinate.
_CHI2_MEDIAN = 1.386


@dataclass(frozen=True)
class Recent:
    """n trajectories that are seen at an instant.

    Attributes
    ----------
    slots
        intp [n].
    position
        float64 [n, 2], px.
    displacement
        float64 [S, n, 2], px; since the time of each of :data:`SCALES_NS` before.
    seen
        bool [S, n]; whether a trajectory was seen then.
    variance
        float64 [n], px²; noise of a coordinate.
    """

    slots: Slots
    position: Floats
    displacement: Floats
    seen: Bools
    variance: Floats

    def of(self, some: Ints) -> "Recent":
        """Some of the trajectories, by index."""
        return Recent(
            self.slots[some],
            self.position[some],
            np.ascontiguousarray(self.displacement[:, some]),
            np.ascontiguousarray(self.seen[:, some]),
            self.variance[some],
        )

    @cached_property
    def reach(self) -> float:
        """Distance in px up to which trajectories are neighbours: an eighth of the extent of all."""
        return float(np.hypot(*np.ptp(self.position, axis=0))) / 8 if len(self.position) else 0.0


def recent_motion(window: Window, stamps: Sequence[int], stamp_ns: int) -> Recent:
    """Displacements up to an instant.

    Parameters
    ----------
    window
        Store of all trajectories.
    stamps
        ns, ascending; instants at which something was observed, up to `stamp_ns`.
    stamp_ns
        The instant.
    """
    slots = window.slots()
    instants = np.array([stamp_ns - scale for scale in SCALES_NS[::-1]] + [stamp_ns], np.int64)
    states = states_at(window, slots, instants)
    here = np.flatnonzero(states.held[-1])
    # Contiguous, so that kernels are compiled for one layout.
    position = np.ascontiguousarray(states.position[::-1][:, here])
    return Recent(
        slots[here],
        position[0],
        position[0] - position[1:],
        np.ascontiguousarray(states.held[-2::-1][:, here]),
        _noise(window, slots[here], np.array(stamps[-_NOISE_INSTANTS:], np.int64)),
    )


def _noise(window: Window, slots: Slots, stamps: Stamps) -> Floats:
    """Variance of a coordinate, px² [n]: a published one, else from third divided differences.

    That of a trajectory is the median of its own, drawn towards the median of its source.
    """
    square = _squared_differences(window, slots, stamps)
    count = np.isfinite(square).sum(axis=0)
    known, own = count > 0, np.zeros(len(slots))
    if known.any():
        # NaN come last: the median is in the middle of those before.
        ranked, middle = np.sort(square[:, known], axis=0), np.stack([count[known] - 1, count[known]]) // 2
        own[known] = np.take_along_axis(ranked, middle, axis=0).mean(axis=0) / _CHI2_MEDIAN
    variance = np.zeros(len(slots))
    for source in np.unique(window.source[slots]).tolist():
        mine = window.source[slots] == source
        pooled = float(np.median(own[mine & known])) if (mine & known).any() else 0.0
        variance[mine] = (_POOL * pooled + count[mine] * own[mine]) / (_POOL + count[mine])
    published = window.sigma[slots, window.stop[slots] - 1]
    return np.where(np.isfinite(published), published**2, variance)


def _squared_differences(window: Window, slots: Slots, stamps: Stamps) -> Floats:
    """Squared third divided differences at unit noise, px² [T - 3, n]; NaN where one is missing."""
    states = states_at(window, slots, stamps)
    place = np.where(states.observed[..., None], states.position, np.nan)
    square = np.full((max(len(stamps) - 3, 0), len(slots)), np.nan)
    for k in range(len(square)):
        times = (stamps[k : k + 4] - stamps[k]) * 1e-9
        apart = times[:, None] - times + np.eye(4)
        weight = 1 / apart.prod(axis=1)
        difference = np.tensordot(weight / np.linalg.norm(weight), place[k : k + 4], axes=1)
        square[k] = (difference**2).sum(axis=1)
    return square
