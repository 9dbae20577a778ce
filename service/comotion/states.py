"""Where trajectories are at an instant: f_i(t) of the thesis, between observations as at them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled
from .window import Bools, Floats, Slots, Stamps, Window

_STEPS_BACK = 3
_FIRST_CUT = 8


@dataclass(frozen=True)
class States:
    """States of n trajectories at T instants.

    Attributes
    ----------
    position
        float64 [T, n, dim]; 0 where not `held`.
    observed
        bool [T, n]; an observation was made at this very instant.
    held
        bool [T, n]; observed, or inside a segment short enough to interpolate.
    """

    position: Floats
    observed: Bools
    held: Bools


def locate(window: Window, slots: Slots, stamp_ns: int | Stamps) -> Slots:
    """Index of the newest observation at or before a time in each slot; ``start - 1`` where none is."""
    start, index = window.start[slots], window.stop[slots] - 1
    # Most questions are about the newest observations: a few steps back come before the bisection.
    for _ in range(_STEPS_BACK):
        later = (index >= start) & (window.times[slots, index] > stamp_ns)
        if not later.any():
            return index
        index -= later
    return _bisect(window, slots, stamp_ns, start, index + 1)


def _bisect(window: Window, slots: Slots, stamp_ns: int | Stamps, low: Slots, high: Slots) -> Slots:
    """Bisection of all slots at once: times[low - 1] <= stamp < times[high]."""
    last = window.times.shape[1] - 1
    # The other questions are about the oldest observations, so the first cut is made near them.
    middle = np.minimum(low + _FIRST_CUT, (low + high) // 2)
    while (low < high).any():
        before = window.times[slots, np.minimum(middle, last)] <= stamp_ns
        open_ = low < high
        low = np.where(open_ & before, middle + 1, low)
        high = np.where(open_ & ~before, middle, high)
        middle = (low + high) // 2
    return low - 1


def states_at(window: Window, slots: Slots, stamps: Stamps) -> States:
    """States at ascending times (int64 [T]), linear between observations (the interpolation of (3.5)).

    Nothing is interpolated across a gap longer than ``window.gap_ns``, nor beyond either end.
    """
    shape = len(stamps), len(slots)
    states = States(np.zeros((*shape, window.dim)), np.zeros(shape, np.bool_), np.zeros(shape, np.bool_))
    columns = window.times, window.positions, window.start, window.stop, window.gap_ns
    _interpolate(*columns, slots, stamps, states.position, states.observed, states.held)
    return states


@compiled()
def _interpolate(
    times: Stamps,
    positions: Floats,
    start: Slots,
    stop: Slots,
    gap_ns: int,
    slots: Slots,
    stamps: Stamps,
    position: Floats,
    observed: Bools,
    held: Bools,
) -> None:
    for n in range(len(slots)):
        s, end = slots[n], stop[slots[n]]
        k = start[s] - 1
        for t in range(len(stamps)):
            stamp = stamps[t]
            if k + 1 < end and times[s, k + 1] <= stamp:
                k += np.searchsorted(times[s, k + 1 : end], stamp, side="right")
            if k < start[s]:
                continue
            exact = times[s, k] == stamp
            if not exact and (k + 1 >= end or times[s, k + 1] - times[s, k] > gap_ns):
                continue
            observed[t, n], held[t, n] = exact, True
            # Erratum: the thesis prints t_i,k+1 - t_j,k for the denominator; it is t_j,k+1 - t_j,k.
            share = 0.0 if exact else (stamp - times[s, k]) / (times[s, k + 1] - times[s, k])
            for c in range(positions.shape[2]):
                left = positions[s, k, c]
                position[t, n, c] = left if exact else left + share * (positions[s, k + 1, c] - left)


def instants(window: Window, slots: Slots, after_ns: int, until_ns: int) -> Stamps:
    """Distinct times in (after, until] at which any of the slots was observed, ascending, int64 [k]."""
    those, index = observations_between(window, slots, after_ns, until_ns + 1)
    return np.unique(window.times[those, index])


def observations_between(window: Window, slots: Slots, after_ns: int, before_ns: int) -> tuple[Slots, Slots]:
    """Observations of slots at times in (after, before): their slots and indices [m], slot by slot."""
    first = locate(window, slots, after_ns) + 1
    counts = locate(window, slots, before_ns - 1) + 1 - first
    starts = np.repeat(first - np.cumsum(counts) + counts, counts)
    return np.repeat(slots, counts), starts + np.arange(len(starts))


@dataclass(frozen=True)
class Insertions:
    """Observations that came late, each between two others of its trajectory: what was there before.

    All arrays are [n, ...]: `slots`, the neighbours' times `t_left`, `t_right` and positions
    `x_left`, `x_right`, and the `speed` that the right one had.
    """

    slots: Slots
    t_left: Stamps
    t_right: Stamps
    x_left: Floats
    x_right: Floats
    speed: Floats

    @classmethod
    def at(cls, window: Window, slots: Slots, index: Slots) -> "Insertions":
        """Of the observations that now are at `index` (not the first nor the last of its slot)."""
        t_left, t_right = window.times[slots, index - 1], window.times[slots, index + 1]
        x_left, x_right = window.positions[slots, index - 1], window.positions[slots, index + 1]
        seconds = (t_right - t_left) * 1e-9
        return cls(
            slots, t_left, t_right, x_left, x_right, np.linalg.norm(x_right - x_left, axis=1) / seconds
        )

    def undo(self, states: Sequence[NDArray[Any]], places: Slots, stamps: Stamps, gap_ns: int) -> None:
        """Put states back to what they were before the insertion.

        Parameters
        ----------
        states
            Position [T, 3, P], speed [T, P], held and observed, bool [T, P].
        places
            intp [n]: where in `states` the slots are.
        stamps
            int64 [T], of the states.
        gap_ns
            Longest time to interpolate across.
        """
        position, speed, held, observed = states
        t, n = np.nonzero((self.t_left < stamps[:, None]) & (stamps[:, None] <= self.t_right))
        p, left, right = places[n], self.t_left[n], self.t_right[n]
        fraction = ((stamps[t] - left) / (right - left))[:, None]
        dim = self.x_left.shape[1]
        position[t, :dim, p] = self.x_left[n] + fraction * (self.x_right - self.x_left)[n]
        speed[t, p] = self.speed[n]
        observed[t, p] = stamps[t] == right
        held[t, p] = observed[t, p] | (right - left <= gap_ns)
