"""Compiled: what trajectories are at some instants, and one pass of that over the sums of all pairs.

The twin in NumPy is :mod:`comotion.thesis.equations`: what is summed is (3.3) over the set (3.5), and what
comes out is the logarithm of (3.4). 128 consecutive rows are a strip, and two strips make a block of
128 x 128 pairs. The blocks of the lower triangle lie one after the other, so that a pass goes through memory
once, however many instants it brings, and more trajectories append blocks.
"""

import math

import numpy as np

from ..arrays import Bools, Floats, Floats32, Slots, Stamps
from ..compiled import compiled, numba_range
from ..trajectories.kernels import newest_at, newest_from, segment_at
from .equations import INCOMPARABLE

STRIP = 128
"""Rows that are worked on together: the sums of 128 x 128 pairs are 524 kB, which the L2 cache holds."""
SAMPLE_PLANES = 8
X, Y, Z, WEIGHT, BOTH, OBSERVED, CHANGING, HELD = range(SAMPLE_PLANES)
"""What a sample holds of a trajectory at an instant: its place (0 beyond the space's dimension), its weight,
and as 1 or 0 whether it has a state (`HELD`), was observed then, its states come or go, or `BOTH`."""
PLANES = 4
WEIGHTS, FIRST, SECOND, SAMPLES = range(PLANES)
"""What a block holds of each pair: Σw, Σwd, Σwd², and how many samples."""
COMPARABLE_SAMPLES = 2
"""Samples from which on a pair can be compared: one has no variance."""
_LOG_INCOMPARABLE = math.log(INCOMPARABLE)
# No affinity is smaller than exp(-40): products with less would be subnormal, and a hundred times as slow.
_MIN_LOG = -40.0


@compiled()
def fill_samples(
    times: Stamps,
    positions: Floats,
    speed: Floats,
    start: Slots,
    stop: Slots,
    gap_ns: int,
    slots: Slots,
    rows: Slots,
    stamps: Stamps,
    after: Stamps,
    until: Stamps,
    samples: Floats,
) -> None:
    """Write what n trajectories are at T ascending instants.

    Parameters
    ----------
    times, positions, speed, start, stop, gap_ns
        The window.
    slots, rows
        intp [n]: the trajectories, and the row of each.
    stamps
        int64 [T] ns.
    after, until
        int64 [n] ns: states later than one and no later than the other come or go.
    samples
        float64 [strips, T, SAMPLE_PLANES, STRIP], zeros before; `WEIGHT` is the speed per second still.
    """
    for n in range(len(slots) if len(stamps) else 0):
        s, strip, inside = slots[n], rows[n] // STRIP, rows[n] % STRIP
        newest = newest_at(times[s], start[s], stop[s], stamps[0])
        for t in range(len(stamps)):
            newest = newest_from(times[s], newest, stop[s], stamps[t])
            left, right, share = segment_at(times[s], start[s], stop[s], newest, stamps[t], gap_ns, 0)
            if left < 0:
                continue
            sample = samples[strip, t, :, inside]
            for c in range(positions.shape[2]):
                before = positions[s, left, c]
                sample[X + c] = before + share * (positions[s, right, c] - before)
            # Between observations the speed is that of the segment, which is kept where it ends.
            sample[WEIGHT] = speed[s, right]
            observed, changing = left == right, after[n] < stamps[t] <= until[n]
            sample[OBSERVED], sample[CHANGING], sample[HELD] = observed, changing, True
            sample[BOTH] = observed and changing


@compiled(parallel=True)
def update_blocks(
    sums: Floats,
    samples: Floats,
    signs: Floats,
    present: Bools,
    rate: float,
    place: Slots,
    out: Floats32,
) -> None:
    """Take samples into the sums of all blocks, and write the logarithms of the affinities that follow.

    Parameters
    ----------
    sums
        float64 [blocks or more, PLANES, STRIP, STRIP]: block ``r * (r + 1) / 2 + c`` has strip r as rows and,
        as columns, strip c <= r.
    samples, signs
        float64 [strips, T or more, SAMPLE_PLANES, STRIP] of :func:`fill_samples`, with weights; and [T], 1
        where samples come and -1 where they go.
    present
        bool [strips, T, SAMPLE_PLANES]: whether any of a strip is not 0.
    rate
        -γ of (3.4).
    place, out
        intp [rows], row and column of `out` for each row, -1 for none; float32 [n, n], symmetric: log(0.5)
        for pairs with fewer than two samples. Empty for no affinities.
    """
    for n in numba_range(len(samples) * (len(samples) + 1) // 2):
        _update_block(sums[n], np.int64(n), samples, signs, present, rate, place, out)


@compiled()
def _update_block(
    block: Floats,
    number: np.int64,
    samples: Floats,
    signs: Floats,
    present: Bools,
    rate: float,
    place: Slots,
    out: Floats32,
) -> None:
    """One block, by its number; the other parameters are those of :func:`update_blocks`."""
    row = int((np.sqrt(8.0 * number + 1.0) - 1.0) / 2.0)
    column = number - row * (row + 1) // 2
    mine, theirs = samples[row], samples[column]
    logs, chosen = np.empty((STRIP, STRIP), np.float32), np.empty(len(signs), np.intp)
    for i in range(STRIP):
        found = 0
        for t in range(len(signs)):
            if mine[t, HELD, i] != 0.0 and present[column, t, _counting(mine[t], i)]:
                chosen[found] = t
                found += 1
        _add_samples(block, i, mine, theirs, signs, chosen[:found])
        if len(out):
            _compare(block, i, rate, logs[i])
    if len(out):
        strips = place.reshape(-1, STRIP)
        _write(logs, strips[row], strips[column], out)
        _write(logs.T, strips[column], strips[row], out)


@compiled()
def _counting(mine: Floats, i: int) -> int:
    """Which plane of the others says whether they have a sample with row i at an instant.

    Both must have a state, one must be observed, and that of one come or go.
    """
    if mine[BOTH, i] != 0.0:
        return HELD
    if mine[OBSERVED, i] != 0.0:
        return CHANGING
    return OBSERVED if mine[CHANGING, i] != 0.0 else BOTH


@compiled(fastmath={"contract"})
def _add_samples(block: Floats, i: int, mine: Floats, theirs: Floats, signs: Floats, chosen: Slots) -> None:
    """Add the samples at some instants of row i to its sums."""
    weights, first, second, samples = block[WEIGHTS, i], block[FIRST, i], block[SECOND, i], block[SAMPLES, i]
    for t in chosen:
        x, y, z, weight = mine[t, X, i], mine[t, Y, i], mine[t, Z, i], mine[t, WEIGHT, i]
        other, counts, sign = theirs[t], theirs[t, _counting(mine[t], i)], signs[t]
        for j in range(STRIP):
            dx, dy, dz = x - other[X, j], y - other[Y, j], z - other[Z, j]
            d = np.sqrt(dx * dx + dy * dy + dz * dz)
            # w of (3.2) grows with v: the larger of two weights is that of the larger speed.
            w = sign * counts[j] * max(weight, other[WEIGHT, j])
            weights[j] += w
            first[j] += w * d
            second[j] += w * d * d
            samples[j] += sign * counts[j]


@compiled(fastmath={"contract"})
def _compare(block: Floats, i: int, rate: float, logs: Floats32) -> None:
    """Logarithms of (3.4), −γσ² with σ² of (3.3), of the pairs of row i."""
    for j in range(STRIP):
        eta = 1.0 / block[WEIGHTS, i, j]
        mean = eta * block[FIRST, i, j]
        variance = max(eta * block[SECOND, i, j] - mean * mean, 0.0)
        comparable = block[SAMPLES, i, j] >= COMPARABLE_SAMPLES
        logs[j] = max(rate * variance, _MIN_LOG) if comparable else _LOG_INCOMPARABLE


@compiled()
def _write(logs: Floats32, mine: Slots, theirs: Slots, out: Floats32) -> None:
    """Write what the pairs of two strips have where it belongs."""
    for i in range(STRIP):
        for j in range(STRIP if mine[i] >= 0 else 0):
            if theirs[j] >= 0:
                out[mine[i], theirs[j]] = logs[i, j]


@compiled(fastmath={"contract"})
def combine_rows(matrix: Floats32, rows: Slots, factors: Floats, out: Floats) -> None:
    """Add some rows of a matrix, each times its factor, to a row.

    Parameters
    ----------
    matrix, rows, factors
        float32 [n, n]; intp [m] and float64 [m].
    out
        float64 [n].
    """
    # Two rows a turn load and store the sums half as often.
    for k in range(0, len(rows) - 1, 2):
        first, second = matrix[rows[k]], matrix[rows[k + 1]]
        for j in range(len(out)):
            out[j] += factors[k] * first[j] + factors[k + 1] * second[j]
    if len(rows) % 2:
        last = matrix[rows[-1]]
        for j in range(len(out)):
            out[j] += factors[-1] * last[j]
