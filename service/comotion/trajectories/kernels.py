"""Compiled loops over the observations of a window: storing, searching, interpolating.

Every function works on the columns of :class:`~comotion.trajectories.window.Window`: `times` int64 [S, M] ns,
`positions` float64 [S, M, dim], `speed` and `sigma` float64 [S, M], for S slots of up to M observations
each, of which ``start[s]:stop[s]`` (intp [S]) are in use.
"""

import numpy as np

from ..arrays import Bools, Floats, Slots, Stamps
from ..compiled import compiled

# Most searches are for the newest or the oldest observations: steps from either end before a bisection.
_LINEAR_STEPS = 4
_SECONDS_PER_NS = 1e-9


@compiled()
def append(
    slots: Slots,
    stamps: Stamps,
    new_positions: Floats,
    new_sigma: Floats,
    times: Stamps,
    positions: Floats,
    speed: Floats,
    sigma: Floats,
    start: Slots,
    stop: Slots,
    complete: Bools,
    far: float,
    far_ns: Stamps,
) -> Slots:
    """Store observations, each behind the newest of its slot, in place; `stop` moves on.

    Returns the index of each in its slot, intp [n]. `far_ns` int64 [S] becomes the stamp of an observation
    that is farther than `far` from the previous one.

    Speed is the backward difference. The first observation of a trajectory takes the second's, while it is
    still in the window (`complete`, bool [S]).
    """
    where = np.empty(len(slots), np.intp)
    for n in range(len(slots)):
        s = slots[n]
        at = where[n] = stop[s]
        times[s, at], sigma[s, at], speed[s, at] = stamps[n], new_sigma[n], 0.0
        squared = 0.0
        for c in range(positions.shape[2]):
            positions[s, at, c] = new_positions[n, c]
            if at > start[s]:
                squared += (positions[s, at, c] - positions[s, at - 1, c]) ** 2
        if squared > far * far:
            far_ns[s] = stamps[n]
        if at > start[s]:
            speed[s, at] = np.sqrt(squared) / ((stamps[n] - times[s, at - 1]) * _SECONDS_PER_NS)
            if at - 1 == start[s] and complete[s]:
                speed[s, at - 1] = speed[s, at]
        stop[s] = at + 1
    return where


@compiled()
def count_older(slots: Slots, before_ns: int, times: Stamps, start: Slots, stop: Slots) -> Slots:
    """How many observations of each of n slots are older than a time, intp [n]."""
    counts = np.zeros(len(slots), np.intp)
    for n in range(len(slots)):
        s = slots[n]
        while start[s] + counts[n] < stop[s] and times[s, start[s] + counts[n]] < before_ns:
            counts[n] += 1
    return counts


@compiled()
def transfer(
    slots: Slots,
    column: Floats | Stamps,
    target: Floats | Stamps,
    start: Slots,
    stop: Slots,
    first: Slots,
) -> None:
    """Copy the observations of slots from one column [S, M, d] to another, there from index `first` [S] on.

    Within one column they may move towards the beginning.
    """
    for n in range(len(slots)):
        s = slots[n]
        for k in range(stop[s] - start[s]):
            for c in range(column.shape[2]):
                target[s, first[s] + k, c] = column[s, start[s] + k, c]


@compiled()
def newest_at(times: Stamps, start: int, stop: int, stamp: int) -> int:
    """Index of the newest time at or before `stamp` among ``times[start:stop]``; ``start - 1`` for none."""
    for _ in range(_LINEAR_STEPS):
        if stop <= start or times[stop - 1] <= stamp:
            return stop - 1
        stop -= 1
    for _ in range(_LINEAR_STEPS):
        if stop <= start or times[start] > stamp:
            return start - 1
        start += 1
    # Backwards by twice as much each time, then bisection.
    reach = _LINEAR_STEPS
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


@compiled()
def newest_from(times: Stamps, index: int, stop: int, stamp: int) -> int:
    """As :func:`newest_at`, when `index` is the answer for an earlier stamp: the walk of ascending stamps."""
    # All steps together are at most the observations; a search for long ones tripled the time of a call.
    while index + 1 < stop and times[index + 1] <= stamp:
        index += 1
    return index


@compiled()
def segment_at(
    times: Stamps, start: int, stop: int, newest: int, stamp: int, max_gap: int, max_ahead: int
) -> tuple[int, int, float]:
    """Between which observations a trajectory is at a time, and where between: (left, right, share).

    The state is ``x[left] + share * (x[right] - x[left])``; the segment that holds it ends at `right`.
    This is f_i(t) of the thesis with the interpolation of (3.5). All that interpolates trajectories calls it.

    Erratum: the thesis prints t_i,k+1 - t_j,k for the denominator; it is t_j,k+1 - t_j,k.

    Parameters
    ----------
    times
        int64 [M] ns, ascending in ``start:stop``.
    start, stop
        The observations of the trajectory.
    newest
        Index of the newest observation at or before `stamp` in ``start:stop``, from :func:`newest_at` or, for
        ascending stamps, from :func:`newest_from`.
    stamp
        Time of the state, ns, on the clock of `times`. If the observations belong to ``times + delay`` on
        another clock, pass ``stamp - delay`` here and to the search for `newest`.
    max_gap
        Longest segment to interpolate, ns.
    max_ahead
        How far past the newest observation the last segment is extended, ns; 0 for not at all. A last segment
        longer than `max_gap`, or a single observation, is extended by a constant.

    Returns
    -------
    left, right, share
        ``left == right`` and share 0 at an observation (then ``times[left] == stamp``, even beside a gap) and
        where the newest is extended by a constant. `share` exceeds 1 past the newest observation. `left` is
        -1 where there is no state: before the first observation, in a gap, or too far ahead.
    """
    if newest < start:
        return -1, -1, 0.0
    if times[newest] == stamp:
        return newest, newest, 0.0
    left, right = newest, newest + 1
    if right >= stop:
        if stamp - times[newest] > max_ahead:
            return -1, -1, 0.0
        left, right = newest - 1, newest
        if left < start or times[right] - times[left] > max_gap:
            return newest, newest, 0.0
    span = times[right] - times[left]
    if span > max_gap:
        return -1, -1, 0.0
    return left, right, (stamp - times[left]) / span


@compiled()
def fill_recent_steps(
    times: Stamps,
    positions: Floats,
    start: Slots,
    stop: Slots,
    slots: Slots,
    span_ns: int,
    step: Floats,
    elapsed: Stamps,
) -> None:
    """Fill step [n, dim] and elapsed [n]: since the newest observation `span_ns` before the last."""
    for n in range(len(slots)):
        s, last = slots[n], stop[slots[n]] - 1
        first = max(newest_at(times[s], start[s], stop[s], times[s, last] - span_ns), start[s])
        elapsed[n] = times[s, last] - times[s, first]
        for c in range(positions.shape[2]):
            step[n, c] = positions[s, last, c] - positions[s, first, c]


@compiled()
def fill_states(
    times: Stamps,
    positions: Floats,
    speed: Floats,
    start: Slots,
    stop: Slots,
    gap_ns: int,
    slots: Slots,
    stamps: Stamps,
    position: Floats,
    pace: Floats,
    observed: Bools,
    held: Bools,
) -> None:
    """Fill position [T, n, dim], pace, observed, held [T, n] at ascending stamps [T], zero and False before.

    The pace is the speed at an observation; between two that of the segment, which is kept where it ends.
    """
    for n in range(len(slots) if len(stamps) else 0):
        s = slots[n]
        newest = newest_at(times[s], start[s], stop[s], stamps[0])
        for t in range(len(stamps)):
            newest = newest_from(times[s], newest, stop[s], stamps[t])
            left, right, share = segment_at(times[s], start[s], stop[s], newest, stamps[t], gap_ns, 0)
            if left < 0:
                continue
            observed[t, n], held[t, n], pace[t, n] = left == right, True, speed[s, right]
            for c in range(positions.shape[2]):
                left_value = positions[s, left, c]
                position[t, n, c] = left_value + share * (positions[s, right, c] - left_value)
