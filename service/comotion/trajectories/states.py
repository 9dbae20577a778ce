"""Where trajectories are at an instant: f_i(t) of the thesis, between observations as at them."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Floats, Slots, Stamps
from ..compiled import compiled
from .window import Window

# Most questions are about the newest or the oldest observations: steps from there before a search.
_STEPS = 4


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
    stamps = np.broadcast_to(np.asarray(stamp_ns, np.int64), slots.shape)
    index = np.empty(len(slots), np.intp)
    _locate(window.times, window.start, window.stop, slots, stamps, index)
    return index


@compiled()
def _locate(times: Stamps, start: Slots, stop: Slots, slots: Slots, stamps: Stamps, index: Slots) -> None:
    for n in range(len(slots)):
        index[n] = newest_at(times[slots[n]], start[slots[n]], stop[slots[n]], stamps[n])


@compiled()
def newest_at(times: Stamps, start: int, stop: int, stamp: int) -> int:
    """Index of the newest time at or before `stamp` among ``times[start:stop]``; ``start - 1`` for none."""
    for _ in range(_STEPS):
        if stop <= start or times[stop - 1] <= stamp:
            return stop - 1
        stop -= 1
    for _ in range(_STEPS):
        if stop <= start or times[start] > stamp:
            return start - 1
        start += 1
    # Backwards by twice as much each time, then bisection.
    reach = _STEPS
    while stop - reach > start and times[stop - reach] > stamp:
        stop -= reach
        reach *= 2
    start = max(start, stop - reach)
    while start < stop:
        middle = (start + stop) // 2
        if times[middle] <= stamp:
            start = middle + 1
        else:
            stop = middle
    return start - 1


def recent_steps(window: Window, slots: Slots, span_ns: int) -> tuple[Floats, Stamps]:
    """How far each slot has come in its last while, float64 [n, dim], and how long that took, int64 [n] ns.

    It begins with the newest observation that is `span_ns` older than the last, or with the first.
    """
    step, took = np.zeros((len(slots), window.dim)), np.zeros(len(slots), np.int64)
    _step(window.times, window.positions, window.start, window.stop, slots, span_ns, step, took)
    return step, took


@compiled()
def _step(
    times: Stamps,
    positions: Floats,
    start: Slots,
    stop: Slots,
    slots: Slots,
    span_ns: int,
    step: Floats,
    took: Stamps,
) -> None:
    for n in range(len(slots)):
        s, last = slots[n], stop[slots[n]] - 1
        first = max(newest_at(times[s], start[s], stop[s], times[s, last] - span_ns), start[s])
        took[n] = times[s, last] - times[s, first]
        for c in range(positions.shape[2]):
            step[n, c] = positions[s, last, c] - positions[s, first, c]


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
