"""States of trajectories at and between observations: f_i(t) of the thesis.

Compiled code that needs states one by one calls :func:`~comotion.trajectories.kernels.segment_at` itself.
"""

from dataclasses import dataclass

from ..arrays import Bools, Floats, Slots, Stamps
from . import kernels
from .window import Window


@dataclass(frozen=True)
class States:
    """States of n trajectories at T instants.

    Attributes
    ----------
    position
        float64 [T, n, dim], in the space's unit; 0 where not `held`.
    speed
        float64 [T, n], per second; between observations that of the segment; 0 where not `held`.
    observed
        bool [T, n]; an observation was made at this very instant.
    held
        bool [T, n]; observed, or inside a segment short enough to interpolate.
    """

    position: Floats
    speed: Floats
    observed: Bools
    held: Bools


def states_at(window: Window, slots: Slots, stamps: Stamps, gap_ns: int | None = None) -> States:
    """States at some instants, linear between observations (3.5).

    Nothing is interpolated across a gap longer than `gap_ns`, by default ``window.gap_ns``, nor beyond either
    end.

    Parameters
    ----------
    window
        Store of the trajectories.
    slots
        intp [n].
    stamps
        int64 [T] ns, ascending.
    """
    longest_ns = window.gap_ns if gap_ns is None else gap_ns
    return States(*kernels.states_at(window.columns, longest_ns, slots, stamps))


def recent_steps(window: Window, slots: Slots, span_ns: int) -> tuple[Floats, Stamps]:
    """How far each trajectory has moved lately.

    A step goes to the newest observation from the newest one that is at least `span_ns` older, or from the
    first.

    Parameters
    ----------
    window
        Store of the trajectories.
    slots
        intp [n], each with an observation.
    span_ns
        Time to look back.

    Returns
    -------
    step
        float64 [n, dim], in the space's unit.
    elapsed
        int64 [n] ns: the time between the two observations; 0 where there is one only.
    """
    return kernels.recent_steps(window.columns, slots, span_ns)
