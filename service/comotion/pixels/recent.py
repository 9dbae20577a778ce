"""The window in; how far trajectories have moved over several time scales, and their noise, out."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots
from ..trajectories.interpolation import states_at
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
        noise_variance(window, slots[here], stamps),
    )
