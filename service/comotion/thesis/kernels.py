"""Compiled: states at some instants, and one pass over the sums of all pairs, block by block.

The twin in NumPy is :mod:`comotion.thesis.equations`: what is summed is (3.3) over the set (3.5), and what
comes out is the logarithm of (3.4). A block holds the pairs of two strips of rows.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Floats32, Slots, Stamps
from ..compiled import compiled, numba_range
from ..trajectories.kernels import newest_at, newest_from, segment_at

Array = NDArray[Any]

STRIP = 64
"""Rows of the pair sums that are worked on together: 64 x 64 pairs are 80 kB, which the L2 cache holds."""
X, Y, Z, WEIGHT, SIGN = range(5)
"""Planes of `values`: coordinates, weight, and from SIGN on one plane for each status of the partner."""
ABSENT = -1
OBSERVED, CHANGING = 1, 2
"""Terms of the status of a trajectory at an instant."""
STATUSES = 4
NEVER, LATEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max
"""Times before and after all others."""
PLANES = 5
SHIFT, WEIGHTS, FIRST, SECOND, SAMPLES = range(PLANES)
"""What a block holds of each pair: a shift, Σw, Σwd', Σwd'² with d' = d − shift, and how many samples."""
COMPARABLE_SAMPLES = 2
"""Samples from which on a pair can be compared: one has no variance."""
_ZERO, _COMPARABLE = np.float32(0), np.float32(COMPARABLE_SAMPLES)
# Of the affinity of a pair that cannot be compared: neither high nor low.
_LOG_HALF = np.float32(math.log(0.5))
# No affinity is smaller than exp(-40): products with less would be subnormal, and a hundred times as slow.
_LEAST_LOG = np.float32(-40)


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
    stamps: Stamps,
    gap_ns: int,
    sign: int,
    rate: float,
    offset: float,
    values: Array,
    status: Array,
    any_partner: Array,
) -> None:
    """Write the states of n trajectories at T ascending instants, T of 1 or more.

    Parameters
    ----------
    times, positions, speeds, start, stop
        Columns of the window.
    slots, rows, after, until
        Of :class:`~comotion.thesis.samples.Participants`.
    stamps
        int64 [T].
    gap_ns
        Longest segment to interpolate.
    sign
        1 where samples come, -1 where they go.
    rate, offset
        Of the weight (3.2), ``1 - exp(rate * v**2 + offset)``.
    values, status, any_partner
        Those of a :class:`~comotion.thesis.samples.SampleBuffer` at the T instants.
    """
    values[:, :, SIGN:] = 0
    status[:] = ABSENT
    any_partner[:] = False
    for n in range(len(slots)):
        s, strip, inside = slots[n], rows[n] // STRIP, rows[n] % STRIP
        newest = newest_at(times[s], start[s], stop[s], stamps[0])
        for t in range(len(stamps)):
            newest = newest_from(times[s], newest, stop[s], stamps[t])
            left, right, share = segment_at(times[s], start[s], stop[s], newest, stamps[t], gap_ns, 0)
            if left < 0:
                continue
            for c in range(positions.shape[2]):
                before = positions[s, left, c]
                values[strip, t, c, inside] = before + share * (positions[s, right, c] - before)
            # It is stored in single precision, of which a difference to 1 leaves enough: none is below 0.002.
            values[strip, t, WEIGHT, inside] = 1.0 - np.exp(rate * speeds[s, right] ** 2 + offset)
            observed, changing = left == right, after[n] < stamps[t] <= until[n]
            status[strip, t, inside] = OBSERVED * observed + CHANGING * changing
            for partner in range(STATUSES):
                if (observed or partner % CHANGING) and (changing or partner >= CHANGING):
                    values[strip, t, SIGN + partner, inside] = sign
                    any_partner[strip, t, partner] = True


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


@compiled(parallel=True)
def update_blocks(
    sums: Array,
    blocks: Slots,
    rows: Slots,
    columns: Slots,
    values: Array,
    status: Array,
    any_partner: Array,
    count: int,
    rate: np.floating[Any],
    place: Slots,
    out: Floats32,
    shared: bool,
) -> tuple[Floats, Floats]:
    """Take samples into the sums of blocks, and write the logarithms of the affinities that follow.

    Parameters
    ----------
    sums
        [blocks, PLANES, STRIP, STRIP].
    blocks, rows, columns
        intp [k]: blocks, and the strips that are their rows and columns.
    values, status, any_partner, count
        Attributes of :class:`~comotion.thesis.samples.SampleBuffer`.
    rate
        -γ of (3.4).
    place, out
        As in :meth:`~comotion.thesis.block_sums.BlockSums.add_and_compare`; or empty, for no affinities.
    shared
        Whether all threads share the work.

    Returns
    -------
    most, reach
        float64 [k]: per block the largest Σwd'², and the largest square of a mean of d'.
    """
    most, reach = np.zeros(len(blocks)), np.zeros(len(blocks))
    samples = values, status, any_partner, count
    if shared:
        for n in numba_range(len(blocks)):
            block, where = sums[blocks[n]], (rows[n], columns[n])
            most[n], reach[n] = _update_block(block, where, samples, rate, place, out)
    else:
        for n in range(len(blocks)):
            block, where = sums[blocks[n]], (rows[n], columns[n])
            most[n], reach[n] = _update_block(block, where, samples, rate, place, out)
    return most, reach


@compiled(fastmath={"contract"})
def _update_block(
    block: Array,
    where: tuple[int, int],
    samples: tuple[Array, Array, Array, int],
    rate: np.floating[Any],
    place: Slots,
    out: Floats32,
) -> tuple[float, float]:
    row, column = where
    values, status, any_partner, count = samples
    largest, farthest = np.zeros(STRIP, block.dtype), np.zeros(STRIP, block.dtype)
    change, logs = np.empty((PLANES, STRIP), block.dtype), np.empty((STRIP, STRIP), np.float32)
    chosen = np.empty(count, np.intp)
    for i in range(STRIP):
        found = _choose_instants(status[row], i, any_partner[column], chosen)
        if found:
            pairs = values[row], values[column], status[row], chosen[:found]
            _begin(block, i, pairs)
            _add_up(block, i, pairs, change)
        for j in range(STRIP):
            largest[j] = max(largest[j], block[SECOND, i, j])
        if len(out):
            _compare(block, i, rate, logs, farthest)
    if len(out):
        mine, theirs = place[row * STRIP : (row + 1) * STRIP], place[column * STRIP : (column + 1) * STRIP]
        _write(logs, mine, theirs, out)
    return largest.max(), farthest.max()


@compiled()
def _choose_instants(status: Array, i: int, any_partner: Array, chosen: Slots) -> int:
    """Fill `chosen`: instants at which row i has a sample with any row of the other strip; how many."""
    found = 0
    for t in range(len(chosen)):
        if status[t, i] >= 0 and any_partner[t, status[t, i]]:
            chosen[found] = t
            found += 1
    return found


@compiled(fastmath={"contract"})
def _begin(block: Array, i: int, pairs: tuple[Array, Array, Array, Slots]) -> None:
    """Let pairs of row i that have no sample yet begin: their first distance is the shift."""
    mine, theirs, status, chosen = pairs
    for j in range(STRIP):
        if block[SAMPLES, i, j] != _ZERO:
            continue
        for plane in range(1, PLANES):
            block[plane, i, j] = _ZERO
        for t in chosen:
            if theirs[t, SIGN + status[t, i], j] > _ZERO:
                dx, dy = mine[t, X, i] - theirs[t, X, j], mine[t, Y, i] - theirs[t, Y, j]
                dz = mine[t, Z, i] - theirs[t, Z, j]
                block[SHIFT, i, j] = np.sqrt(dx * dx + dy * dy + dz * dz)
                break


@compiled(fastmath={"contract"})
def _add_up(block: Array, i: int, pairs: tuple[Array, Array, Array, Slots], change: Array) -> None:
    """Add the samples of row i to its sums; `change`, [PLANES, STRIP], is overwritten."""
    mine, theirs, status, chosen = pairs
    for plane in range(1, PLANES):
        for j in range(STRIP):
            change[plane, j] = _ZERO
    shift = block[SHIFT, i]
    for t in chosen:
        x, y, z, weight = mine[t, X, i], mine[t, Y, i], mine[t, Z, i], mine[t, WEIGHT, i]
        other, sign = theirs[t], theirs[t, SIGN + status[t, i]]
        for j in range(STRIP):
            dx, dy, dz = x - other[X, j], y - other[Y, j], z - other[Z, j]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz) - shift[j]
            # w of (3.2) grows with v: the larger of two weights is that of the larger speed.
            share = max(weight, other[WEIGHT, j]) * sign[j]
            change[WEIGHTS, j] += share
            change[FIRST, j] += share * distance
            change[SECOND, j] += share * distance * distance
            change[SAMPLES, j] += sign[j]
    for plane in range(1, PLANES):
        for j in range(STRIP):
            block[plane, i, j] += change[plane, j]


@compiled(fastmath={"contract"})
def _compare(block: Array, i: int, rate: np.floating[Any], logs: Floats32, farthest: Array) -> None:
    """Logarithms of (3.4), −γσ² with σ² of (3.3), of the pairs of row i."""
    for j in range(STRIP):
        comparable = block[SAMPLES, i, j] >= _COMPARABLE
        mean = block[FIRST, i, j] / block[WEIGHTS, i, j]
        variance = max((block[SECOND, i, j] - block[FIRST, i, j] * mean) / block[WEIGHTS, i, j], _ZERO)
        logs[i, j] = max(rate * variance, _LEAST_LOG) if comparable else _LOG_HALF
        farthest[j] = max(farthest[j], mean * mean if comparable else _ZERO)


@compiled()
def _write(logs: Floats32, mine: Slots, theirs: Slots, out: Floats32) -> None:
    """Write a block on both sides of the diagonal."""
    for i in range(STRIP):
        for j in range(STRIP):
            if mine[i] >= 0 and theirs[j] >= 0:
                out[mine[i], theirs[j]] = logs[i, j]
    for j in range(STRIP):
        for i in range(STRIP):
            if mine[i] >= 0 and theirs[j] >= 0:
                out[theirs[j], mine[i]] = logs[i, j]


@compiled(parallel=True)
def gather(matrix: Floats32, members: Slots) -> Floats32:
    """Rows and columns of a matrix, float32 [n, n]: as NumPy's fancy indices, in a tenth of the time."""
    n = len(members)
    found = np.empty((n, n), np.float32)
    for r in numba_range(n):
        row = matrix[members[r]]
        for c in range(n):
            found[r, c] = row[members[c]]
    return found
