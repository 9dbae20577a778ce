"""Measures how far the trajectories of a window have moved over several time scales, and their noise."""

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..trajectories.window import Window
from .noise import noise_variance

SCALES_NS = (100_000_000, 250_000_000, 1_000_000_000, 3_000_000_000)
"""ns; over which motion is looked at: a hand moves within the first two, a slow drawer within the others."""


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
    tolerance
        float64 [S, n], px²; besides noise and drift, variance of what rests in the world before a camera that
        moves (:mod:`.steadying`); 0 before one that rests.
    """

    slots: Slots
    position: Floats
    displacement: Floats
    seen: Bools
    variance: Floats
    tolerance: Floats

    def of(self, tracks: Ints) -> "Recent":
        """Some of the trajectories, by index."""
        return Recent(
            self.slots[tracks],
            self.position[tracks],
            self.displacement.take(tracks, 1),
            self.seen.take(tracks, 1),
            self.variance[tracks],
            self.tolerance.take(tracks, 1),
        )

    @cached_property
    def reach(self) -> float:
        """Distance in px up to which trajectories are neighbours: an eighth of the extent of all."""
        return float(np.hypot(*np.ptp(self.position, axis=0))) / 8 if len(self.position) else 0.0


def recent_motion(window: Window, stamp_ns: int) -> Recent:
    """Displacements up to an instant.

    Parameters
    ----------
    window
        Store of all trajectories.
    stamp_ns
        The instant.
    """
    slots, stamps = window.slots(), window.instants[: bisect_right(window.instants, stamp_ns)]
    states = window.states_at(slots, np.array([stamp_ns], np.int64))
    present = np.flatnonzero(states.held[0])
    slots, position = slots[present], states.position[0, present]
    past, seen = _past_places(window, slots, np.array(stamps, np.int64), stamp_ns - np.array(SCALES_NS))
    variance = noise_variance(window, slots, stamps)
    return Recent(slots, position, position - past, seen, variance, np.zeros(seen.shape))


def _past_places(window: Window, slots: Slots, stamps: Stamps, times: Stamps) -> tuple[Floats, Bools]:
    """Where trajectories were at times [S] ns, [S, n, 2] px, and whether they were seen, bool [S, n].

    The place is the median of that and of those at the instants before and after, so that one gross error
    makes nothing move.
    """
    nearest = np.abs(times[:, None] - stamps).argmin(axis=1)
    before, after = stamps[np.maximum(nearest - 1, 0)], stamps[np.minimum(nearest + 1, len(stamps) - 1)]
    instants, rows = np.unique(np.stack([before, times, after], axis=1), return_inverse=True)
    states = window.states_at(slots, instants)
    place, held = states.position[rows.reshape(-1, 3)], states.held[rows.reshape(-1, 3)]
    held_in_all = held[:, 0] & held[:, 1] & held[:, 2]
    # Contiguous, so that kernels are compiled for one layout.
    past = np.where(held_in_all[..., None], np.sort(place, axis=1)[:, 1], place[:, 1])
    return np.ascontiguousarray(past), np.ascontiguousarray(held[:, 1])
