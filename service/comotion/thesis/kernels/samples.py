"""Compiled: states of trajectories at some instants, laid out for the pass over the sums of all pairs.

The arrays `values`, `status` and `any_partner` are those of
:class:`~comotion.thesis.sample_buffer.SampleBuffer`; so are the words strip, status and partner.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Floats, Slots, Stamps
from ...compiled import compiled
from ...trajectories.kernels import newest_at, newest_from, segment_at

Array = NDArray[Any]

STRIP = 64
"""Rows of the pair sums that are worked on together: 64 x 64 pairs are 80 kB, which the L2 cache holds."""
X, Y, Z, WEIGHT, SIGN = range(5)
"""Planes of `values`: coordinates, weight, and from SIGN on one plane for each status of the partner."""
ABSENT = -1
OBSERVED, CHANGING = 1, 2
"""Bits of the status of a trajectory at an instant."""
STATUSES = 4
NEVER = np.iinfo(np.int64).min
"""Time before all others."""


@compiled()
def fill_samples(
    times: Stamps,
    positions: Floats,
    speeds: Floats,
    start: Slots,
    stop: Slots,
    slots: Slots,
    rows: Slots,
    after: Stamps,
    until: Stamps,
    known: Stamps,
    stamps: Stamps,
    gap_ns: int,
    sign: int,
    rate: float,
    offset: float,
    begin: int,
    values: Array,
    status: Array,
    any_partner: Array,
) -> None:
    """Write the states of n trajectories at T ascending instants behind the first `begin` instants.

    Parameters
    ----------
    times, positions, speeds, start, stop
        Columns of the window.
    slots, rows, after, until, known
        Of :class:`~comotion.thesis.sample_buffer.Participants`.
    stamps
        int64 [T].
    gap_ns
        Longest segment to interpolate.
    sign
        1 where samples come, -1 where they go.
    rate, offset
        Of the weight (3.2), ``1 - exp(rate * v**2 + offset)``.
    """
    count = len(stamps)
    values[:, begin : begin + count, SIGN:] = 0
    status[:, begin : begin + count] = ABSENT
    any_partner[:, begin : begin + count] = False
    for n in range(len(slots) if count else 0):
        s, row, first, end = slots[n], rows[n], start[slots[n]], stop[slots[n]]
        while end > first and times[s, end - 1] > known[n]:
            end -= 1
        newest = newest_at(times[s], first, end, stamps[0])
        for t in range(count):
            stamp = stamps[t]
            newest = newest_from(times[s], newest, end, stamp)
            left, right, share = segment_at(times[s], first, end, newest, stamp, gap_ns, 0)
            if left < 0:
                continue
            for c in range(positions.shape[2]):
                before = positions[s, left, c]
                state = before + share * (positions[s, right, c] - before)
                values[row // STRIP, begin + t, c, row % STRIP] = state
            weight = _weight(speeds[s, right], rate, offset)
            changing = after[n] < stamp <= until[n]
            _enter(values, status, any_partner, row, begin + t, weight, left == right, changing, sign)


@compiled()
def _weight(speed: float, rate: float, offset: float) -> float:
    # It is stored in single precision, of which a difference to 1 leaves enough: none is below 0.002.
    return float(1.0 - np.exp(rate * speed * speed + offset))


@compiled()
def _enter(
    values: Array,
    status: Array,
    any_partner: Array,
    row: int,
    t: int,
    weight: float,
    observed: bool,
    changing: bool,
    sign: int,
) -> None:
    """Enter a trajectory that has a state at an instant: with which partners it has a sample."""
    strip, inside = row // STRIP, row % STRIP
    values[strip, t, WEIGHT, inside] = weight
    status[strip, t, inside] = OBSERVED * observed + CHANGING * changing
    for partner in range(STATUSES):
        if (observed or partner & OBSERVED) and (changing or partner & CHANGING):
            values[strip, t, SIGN + partner, inside] = sign
            any_partner[strip, t, partner] = True


@compiled()
def restore_segments(
    times: Stamps,
    positions: Floats,
    speed: Floats,
    rows: Slots,
    stamps: Stamps,
    gap_ns: int,
    sign: int,
    rate: float,
    offset: float,
    begin: int,
    values: Array,
    status: Array,
    any_partner: Array,
) -> None:
    """Overwrite states inside segments by what they were before late observations divided the segments.

    Parameters
    ----------
    times, positions, speed
        Of :class:`~comotion.thesis.sample_buffer.LateObservations`.
    rows
        intp [n], their rows of the pair sums.
    stamps, gap_ns, sign, rate, offset
        As in :func:`fill_samples`, which has written the same instants.
    """
    for n in range(len(rows)):
        strip, inside = rows[n] // STRIP, rows[n] % STRIP
        for t in range(len(stamps)):
            if not times[n, 0] < stamps[t] <= times[n, 1]:
                continue
            status[strip, begin + t, inside] = ABSENT
            values[strip, begin + t, SIGN:, inside] = 0
            newest = 1 if stamps[t] == times[n, 1] else 0
            left, right, share = segment_at(times[n], 0, 2, newest, stamps[t], gap_ns, 0)
            if left < 0:
                continue
            for c in range(positions.shape[2]):
                before = positions[n, left, c]
                values[strip, begin + t, c, inside] = before + share * (positions[n, right, c] - before)
            weight = _weight(speed[n], rate, offset)
            _enter(values, status, any_partner, rows[n], begin + t, weight, left == right, True, sign)


@compiled()
def find_unsummed(
    times: Stamps, start: Slots, stop: Slots, slots: Slots, known: Stamps, gap_ns: int, after: Stamps
) -> None:
    """Fill after [n] ns: states of a slot later than this are not in the sums yet.

    `known` int64 [S] is the newest observation of each slot that is, or NEVER.
    """
    for n in range(len(slots)):
        s, past = slots[n], known[slots[n]]
        first = newest_at(times[s], start[s], stop[s], past) + 1
        # The segment that ends with the first new observation is new as well.
        follows = first > start[s] and past != NEVER and times[s, first] - past <= gap_ns
        after[n] = past if follows else times[s, first] - 1
