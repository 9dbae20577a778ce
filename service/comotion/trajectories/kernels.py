"""Compiled: observations into the columns of a window, for many slots at once."""

import numpy as np

from ..arrays import Bools, Floats, Slots, Stamps
from ..compiled import compiled

# Slots make room in so many turns.
_TURNS = 16


@compiled()
def append(
    slots: Slots,
    stamp_ns: int,
    new_positions: Floats,
    new_sigma: Floats,
    times: Stamps,
    positions: Floats,
    speed: Floats,
    sigma: Floats,
    start: Slots,
    stop: Slots,
    whole: Bools,
) -> None:
    """One observation per slot behind its newest, in place; `stop` moves on.

    Speed is the backward difference; the first observation of a whole trajectory takes the second's.
    """
    for n in range(len(slots)):
        s = slots[n]
        at = stop[s]
        times[s, at], sigma[s, at], speed[s, at] = stamp_ns, new_sigma[n], 0.0
        squared = 0.0
        for c in range(positions.shape[2]):
            positions[s, at, c] = new_positions[n, c]
            if at > start[s]:
                squared += (positions[s, at, c] - positions[s, at - 1, c]) ** 2
        if at > start[s]:
            speed[s, at] = np.sqrt(squared) / ((stamp_ns - times[s, at - 1]) * 1e-9)
            if at - 1 == start[s] and whole[s]:
                speed[s, at - 1] = speed[s, at]
        stop[s] = at + 1


@compiled()
def older(slots: Slots, before_ns: int, times: Stamps, start: Slots, stop: Slots) -> Slots:
    """How many observations of each slot are older than a time, intp [n]."""
    counts = np.zeros(len(slots), np.intp)
    for n in range(len(slots)):
        s = slots[n]
        while start[s] + counts[n] < stop[s] and times[s, start[s] + counts[n]] < before_ns:
            counts[n] += 1
    return counts


@compiled()
def crowded(slots: Slots, start: Slots, stop: Slots, rows: int) -> Slots:
    """Those slots that should make room: at the end of their rows, or near it and worth it.

    Slots that were opened together would run out of room together: some make room ahead of time.
    """
    due = np.empty(len(slots), np.intp)
    count = 0
    for s in slots:
        ahead = s % _TURNS * (rows // (4 * _TURNS))
        if stop[s] == rows or (start[s] >= rows // 4 and stop[s] >= rows - ahead):
            due[count] = s
            count += 1
    return due[:count]


@compiled()
def compact(
    slots: Slots,
    times: Stamps,
    positions: Floats,
    speed: Floats,
    sigma: Floats,
    start: Slots,
    stop: Slots,
) -> None:
    """Move the observations of slots to the beginning of their rows, in place."""
    for n in range(len(slots)):
        s = slots[n]
        first = start[s]
        for k in range(stop[s] - first):
            times[s, k], speed[s, k], sigma[s, k] = (
                times[s, first + k],
                speed[s, first + k],
                sigma[s, first + k],
            )
            for c in range(positions.shape[2]):
                positions[s, k, c] = positions[s, first + k, c]


@compiled()
def transfer(
    slots: Slots, column: Floats | Stamps, grown: Floats | Stamps, start: Slots, stop: Slots
) -> None:
    """Copy the observations of slots from one column [S, M, d] to the same places in another, larger one."""
    for n in range(len(slots)):
        s = slots[n]
        for k in range(start[s], stop[s]):
            for c in range(column.shape[2]):
                grown[s, k, c] = column[s, k, c]
