"""Compiled loops over the observations of a window: storing, searching, interpolating."""

from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats, Slots, Stamps
from ..compiled import compiled

_SECONDS_PER_NS = 1e-9


class Columns(NamedTuple):
    """Columns of :class:`~comotion.trajectories.window.Window`, of S slots of up to M observations each."""

    times: Stamps
    """int64 [S, M], ns."""
    positions: Floats
    speed: Floats
    sigma: Floats
    quaternions: Floats
    """float64 [S, M, dim], [S, M], [S, M] and [S, M, 4], the last [0, 0, 0] where there are none."""
    start: Slots
    stop: Slots
    """intp [S]: the observations in use are ``start[s]:stop[s]``."""


class States(NamedTuple):
    """States of n trajectories at T instants."""

    position: Floats
    """float64 [T, n, dim], in the space's unit; 0 where not `held`."""
    speed: Floats
    """float64 [T, n], per second; between observations that of the segment; 0 where not `held`."""
    observed: Bools
    """bool [T, n]; an observation was made at this very instant."""
    held: Bools
    """bool [T, n]; observed, or inside a segment short enough to interpolate."""


@compiled()
def insert(
    slots: Slots,
    stamps: Stamps,
    new: tuple[Floats, Floats, Floats],
    columns: Columns,
    newest_ns: tuple[Stamps, Stamps],
    complete: Bools,
    far: float,
) -> Bools:
    """Store observations, each in its place in time; returns which, bool [n], as a slot has one a time.

    Speed is the backward difference. The first observation of a trajectory takes the second's, while it is
    still in the window (`complete`, bool [S]). The stamps are ascending in each slot; `new` are positions
    float64 [n, dim], sigma [n] and quaternions [n, 4]. In `newest_ns`, int64 [S] each, are the time of the
    newest observation ever, and of the newest one that was farther than `far` from the previous one. They and
    the columns are changed in place.
    """
    times, positions, speed, sigma, quaternions, start, stop = columns
    (new_positions, new_sigma, new_quaternions), (last_ns, far_ns) = new, newest_ns
    stored = np.zeros(len(slots), np.bool_)
    for n in range(len(slots)):
        s, stamp, at = slots[n], stamps[n], stop[slots[n]]
        if at > start[s] and times[s, at - 1] >= stamp:
            at = _place_between(columns, s, stamp)
            if at < 0:
                continue
        times[s, at], sigma[s, at] = stamp, new_sigma[n]
        for c in range(positions.shape[2]):
            positions[s, at, c] = new_positions[n, c]
        if len(quaternions):
            quaternions[s, at] = new_quaternions[n]
        stored[n], stop[s], last_ns[s] = True, stop[s] + 1, max(last_ns[s], stamp)
        # The speed of the next one becomes what it would have been had this one come in time.
        for k in range(at, min(at + 2, stop[s])):
            previous, squared = max(k - 1, start[s]), 0.0
            for c in range(positions.shape[2]):
                squared += (positions[s, k, c] - positions[s, previous, c]) ** 2
            elapsed = max(times[s, k] - times[s, previous], 1)
            speed[s, k] = np.sqrt(squared) / (elapsed * _SECONDS_PER_NS)
            if k == start[s] + 1 and complete[s]:
                speed[s, k - 1] = speed[s, k]
            if k == stop[s] - 1 and squared > far * far:
                far_ns[s] = times[s, k]
    return stored


@compiled()
def _place_between(columns: Columns, s: int, stamp: int) -> int:
    """Move the observations of a slot that are later than a time on by one; -1 where one has that time.

    Returns the index of the place between them.
    """
    times, stop = columns.times, columns.stop[s]
    at = newest_at(times[s], columns.start[s], stop, stamp) + 1
    if at > columns.start[s] and times[s, at - 1] == stamp:
        return -1
    for k in range(stop, at, -1):
        times[s, k], columns.speed[s, k] = times[s, k - 1], columns.speed[s, k - 1]
        columns.sigma[s, k], columns.positions[s, k] = columns.sigma[s, k - 1], columns.positions[s, k - 1]
        if len(columns.quaternions):
            columns.quaternions[s, k] = columns.quaternions[s, k - 1]
    return at


@compiled()
def newest_at(times: Stamps, start: int, stop: int, stamp: int) -> int:
    """Index of the newest time at or before `stamp` among ``times[start:stop]``; ``start - 1`` for none."""
    if stop > start and times[stop - 1] <= stamp:
        return stop - 1
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

    The observations of the trajectory are ``start:stop``; `newest` is the newest one at or before `stamp`,
    from :func:`newest_at` or, for ascending stamps, from :func:`newest_from`. If they belong to ``times +
    delay`` on another clock, pass ``stamp - delay`` here and to the search for `newest`. Segments longer than
    `max_gap` are not interpolated. The last one is extended by up to `max_ahead`; one that is too long, or a
    single observation, by a constant.

    ``left == right`` and share 0 at an observation (then ``times[left] == stamp``, even beside a gap) and
    where the newest is extended by a constant. `share` exceeds 1 past the newest observation. `left` is -1
    where there is no state: before the first observation, in a gap, or too far ahead.
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
def recent_steps(columns: Columns, slots: Slots, span_ns: int) -> tuple[Floats, Stamps]:
    """How far trajectories, each with an observation, have moved lately.

    A step, float64 [n, dim], goes to the newest observation from the newest one that is at least `span_ns`
    older, or from the first. With the time between the two, int64 [n] ns: 0 where there is one only.
    """
    times, positions, start, stop = columns.times, columns.positions, columns.start, columns.stop
    step, elapsed = np.zeros((len(slots), positions.shape[2])), np.zeros(len(slots), np.int64)
    for n in range(len(slots)):
        s, last = slots[n], stop[slots[n]] - 1
        first = max(newest_at(times[s], start[s], stop[s], times[s, last] - span_ns), start[s])
        elapsed[n] = times[s, last] - times[s, first]
        for c in range(positions.shape[2]):
            step[n, c] = positions[s, last, c] - positions[s, first, c]
    return step, elapsed


@compiled()
def states_at(columns: Columns, gap_ns: int, slots: Slots, stamps: Stamps) -> States:
    """States of slots [n] at ascending instants [T]: f_i(t) of the thesis, linear between observations (3.5).

    Nothing is interpolated across a gap longer than `gap_ns`, nor beyond either end. The speed is that at an
    observation; between two that of the segment, which is kept where it ends.
    """
    times, positions, start, stop = columns.times, columns.positions, columns.start, columns.stop
    shape = len(stamps), len(slots)
    position, pace = np.zeros((*shape, positions.shape[2])), np.zeros(shape)
    observed, held = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    for n in range(len(slots) if len(stamps) else 0):
        s = slots[n]
        newest = newest_at(times[s], start[s], stop[s], stamps[0])
        for t in range(len(stamps)):
            newest = newest_from(times[s], newest, stop[s], stamps[t])
            left, right, share = segment_at(times[s], start[s], stop[s], newest, stamps[t], gap_ns, 0)
            if left < 0:
                continue
            observed[t, n], held[t, n], pace[t, n] = left == right, True, columns.speed[s, right]
            for c in range(positions.shape[2]):
                left_value = positions[s, left, c]
                position[t, n, c] = left_value + share * (positions[s, right, c] - left_value)
    return States(position, pace, observed, held)
