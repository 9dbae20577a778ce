"""Compiled: one pass over the sums of all pairs, with the samples of trajectories at some instants.

The twin in NumPy is :mod:`comotion.thesis.equations`: what is summed is (3.3) over the set (3.5), and what
comes out is the logarithm of (3.4). 64 consecutive slots are a strip, and two strips make a block of 64 x 64
pairs. The blocks of the lower triangle lie one after the other, so that a pass goes through memory once,
however many instants it brings, and more trajectories append blocks.
"""

import math

import numpy as np

from ..arrays import Floats, Floats32, Slots
from ..compiled import compiled, numba_range

STRIP = 64
"""Slots that are worked on together: the sums of 64 x 64 pairs are 131 kB, which the L2 cache holds."""
SAMPLE_PLANES = 7
X, Y, Z, WEIGHT, OBSERVED, CHANGING, SIGN = range(SAMPLE_PLANES)
"""What a sample holds of a trajectory at an instant: its place (0 beyond the space's dimension), its weight,
1 or 0 whether it was observed then and whether its states come or go, and 1 where they come, -1 where they
go; all 0 where it has no state."""
PLANES = 4
WEIGHTS, FIRST, SECOND, SAMPLES = range(PLANES)
"""What a block holds of each pair: Σw, Σwd, Σwd², and how many samples."""
COMPARABLE_SAMPLES = 2
"""Samples from which on a pair can be compared: one has no variance."""
# Of the affinity of a pair that cannot be compared: neither high nor low.
_LOG_HALF = math.log(0.5)
# No affinity is smaller than exp(-40): products with less would be subnormal, and a hundred times as slow.
_LEAST_LOG = -40.0


@compiled(parallel=True)
def update_blocks(
    sums: Floats,
    strips: int,
    samples: Floats,
    count: int,
    rate: float,
    place: Slots,
    out: Floats32,
    shared: bool,
) -> None:
    """Take samples into the sums of all blocks, and write the logarithms of the affinities that follow.

    Parameters
    ----------
    sums
        float64 [blocks or more, PLANES, STRIP, STRIP]: block ``r * (r + 1) / 2 + c`` has the slots of strip r
        as rows and, as columns, those of strip c <= r.
    strips
        How many are in use.
    samples, count
        float64 [strips, T or more, SAMPLE_PLANES, STRIP], and T.
    rate
        -γ of (3.4).
    place, out
        intp [slots], row and column of `out` for each slot, -1 for none; float32 [n, n], symmetric: log(0.5)
        for pairs with fewer than two samples. Empty for no affinities.
    shared
        Whether all threads share the work.
    """
    blocks = strips * (strips + 1) // 2
    if shared:
        for n in numba_range(blocks):
            _update_block(sums[n], np.int64(n), samples, count, rate, place, out)
    else:
        for n in range(blocks):
            _update_block(sums[n], np.int64(n), samples, count, rate, place, out)


@compiled(fastmath={"contract"})
def _update_block(
    block: Floats, number: np.int64, samples: Floats, count: int, rate: float, place: Slots, out: Floats32
) -> None:
    """One block, by its number; the other parameters are those of :func:`update_blocks`."""
    row = int((np.sqrt(8.0 * number + 1.0) - 1.0) / 2.0)
    column = number - row * (row + 1) // 2
    mine, theirs = samples[row], samples[column]
    logs, chosen = np.empty((STRIP, STRIP), np.float32), np.empty(count, np.intp)
    held, observed, changing = np.zeros(count), np.zeros(count), np.zeros(count)
    for t in range(count):
        for j in range(STRIP):
            held[t] = max(held[t], abs(theirs[t, SIGN, j]))
            observed[t] = max(observed[t], theirs[t, OBSERVED, j])
            changing[t] = max(changing[t], theirs[t, CHANGING, j])
    for i in range(STRIP):
        found = 0
        for t in range(count):
            # A pair has a sample where both have a state, one is observed, and one comes or goes.
            either = max(mine[t, OBSERVED, i], observed[t]) * max(mine[t, CHANGING, i], changing[t])
            if mine[t, SIGN, i] * held[t] * either != 0.0:
                chosen[found] = t
                found += 1
        _add_samples(block, i, mine, theirs, chosen[:found])
        if len(out):
            _compare(block, i, rate, logs[i])
    if len(out):
        _write(
            logs, place[row * STRIP : (row + 1) * STRIP], place[column * STRIP : (column + 1) * STRIP], out
        )


@compiled(fastmath={"contract"})
def _add_samples(block: Floats, i: int, mine: Floats, theirs: Floats, chosen: Slots) -> None:
    """Add the samples at some instants of row i to its sums."""
    weights, first, second, samples = block[WEIGHTS, i], block[FIRST, i], block[SECOND, i], block[SAMPLES, i]
    for t in chosen:
        x, y, z, weight = mine[t, X, i], mine[t, Y, i], mine[t, Z, i], mine[t, WEIGHT, i]
        observed, changing, other = mine[t, OBSERVED, i], mine[t, CHANGING, i], theirs[t]
        for j in range(STRIP):
            dx, dy, dz = x - other[X, j], y - other[Y, j], z - other[Z, j]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            sign = other[SIGN, j] * max(observed, other[OBSERVED, j]) * max(changing, other[CHANGING, j])
            # w of (3.2) grows with v: the larger of two weights is that of the larger speed.
            share = sign * max(weight, other[WEIGHT, j])
            weights[j] += share
            first[j] += share * distance
            second[j] += share * distance * distance
            samples[j] += sign


@compiled(fastmath={"contract"})
def _compare(block: Floats, i: int, rate: float, logs: Floats32) -> None:
    """Logarithms of (3.4), −γσ² with σ² of (3.3), of the pairs of row i."""
    for j in range(STRIP):
        mean = block[FIRST, i, j] / block[WEIGHTS, i, j]
        variance = max(block[SECOND, i, j] / block[WEIGHTS, i, j] - mean * mean, 0.0)
        comparable = block[SAMPLES, i, j] >= COMPARABLE_SAMPLES
        logs[j] = max(rate * variance, _LEAST_LOG) if comparable else _LOG_HALF


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
