"""Compiled: the sums of (3.3) over all pairs, step by step, and the affinities (3.4) that follow.

The twin in NumPy is `tests/reference/thesis.py`. :func:`_add_samples` and :func:`_compare` are those two
steps for a block, the pairs of two strips of 128 rows. The blocks of the lower triangle lie one after the
other, so that a pass goes through memory once, however many instants it brings, and more trajectories append
blocks.
"""

import numpy as np

from ..arrays import Bools, Floats, Floats32, Ints
from ..compiled import compiled, numba_range

STRIP = 128
"""Rows that are worked on together: the sums of 128 x 128 pairs are 524 kB, which the L2 cache holds."""
SAMPLE_PLANES = 8
X, Y, Z, WEIGHT, BOTH, OBSERVED, CHANGING, HELD = range(SAMPLE_PLANES)
"""Planes of a sample of a trajectory at an instant: its place (0 beyond the space's dimension), its weight,
and as 1 or 0 whether it has a state (`HELD`), was observed then, its state comes or goes, or `BOTH`."""
PLANES = 4
WEIGHTS, FIRST, SECOND, SAMPLES = range(PLANES)
"""Planes of a block, for each pair: Σw, Σwd, Σwd², and the number of samples."""
COMPARABLE_SAMPLES = 2
"""Samples from which on a pair can be compared: one has no variance."""
INCOMPARABLE = 0.5
"""Affinity of a pair with fewer than two common samples: neither high nor low."""
# No affinity is smaller than exp(-40): products with less would be subnormal, and a hundred times as slow.
_MIN_LOG = -40.0
# exp(x) is exp(x / 256) squared eight times. Six terms of its series leave 1e-8 of the smallest affinity.
_SQUARINGS = 8


@compiled(parallel=True)
def update_pairs(
    sums: Floats, samples: Floats, signs: Floats, present: Bools, rate: float, affinity: Floats32
) -> None:
    """Take samples into the sums of all blocks, and write the affinities that follow, where they are wanted.

    Block ``r * (r + 1) / 2 + c`` of sums float64 [blocks or more, STRIP, PLANES, STRIP] has strip r as rows
    and, as columns, strip c <= r. Samples are float64 [strips, T or more, SAMPLE_PLANES, STRIP]; signs [T]
    are 1 where they come, -1 where they go; `present` says whether any of a strip is not 0. The affinity
    float32 [rows, rows] is symmetric, or empty; `rate` is -γ of (3.4).
    """
    for n in numba_range(len(samples) * (len(samples) + 1) // 2):
        number = np.int64(n)
        r = int((np.sqrt(8.0 * number + 1.0) - 1.0) / 2.0)
        c = number - r * (r + 1) // 2
        _add_samples(sums[number], samples[r], samples[c], signs, present[c])
        if len(affinity):
            block = np.empty((STRIP, STRIP), np.float32)
            _compare(sums[number], rate, block)
            rows, columns = slice(r * STRIP, (r + 1) * STRIP), slice(c * STRIP, (c + 1) * STRIP)
            affinity[rows, columns] = block
            affinity[columns, rows] = block.T


@compiled(fastmath={"contract"})
def _add_samples(
    sums: Floats, row_samples: Floats, column_samples: Floats, signs: Floats, present: Bools
) -> None:
    """Add the samples of the rows and the columns of a block at some instants to its sums."""
    for i in range(STRIP):
        row = sums[i]
        for t in range(len(signs)):
            own, other, sign = row_samples[t], column_samples[t], signs[t]
            # A pair has a sample if both have a state, either is observed, and the state of either comes or
            # goes. What the row does not fulfil, the column must.
            need = BOTH + int(2 * own[OBSERVED, i] + own[CHANGING, i])
            if own[HELD, i] == 0.0 or not present[t, need]:
                continue
            x, y, z, weight, counted = own[X, i], own[Y, i], own[Z, i], own[WEIGHT, i], other[need]
            for j in range(STRIP):
                dx, dy, dz = x - other[X, j], y - other[Y, j], z - other[Z, j]
                d = np.sqrt(dx * dx + dy * dy + dz * dz)
                count = sign * counted[j]
                # w of (3.2) grows with v: the larger of two weights is that of the larger speed.
                w = count * max(weight, other[WEIGHT, j])
                row[WEIGHTS, j] += w
                row[FIRST, j] += w * d
                row[SECOND, j] += w * d * d
                row[SAMPLES, j] += count


@compiled(fastmath={"contract"})
def _compare(sums: Floats, rate: float, affinity: Floats32) -> None:
    """Affinities (3.4), exp(−γσ²) with σ² of (3.3), of the pairs of a block: float32 [STRIP, STRIP]."""
    for i in range(STRIP):
        row = sums[i]
        for j in range(STRIP):
            eta = 1.0 / row[WEIGHTS, j]
            mean = eta * row[FIRST, j]
            variance = max(eta * row[SECOND, j] - mean * mean, 0.0)
            y = max(rate * variance, _MIN_LOG) * (1 / 2**_SQUARINGS)
            # A series instead of a call, so that the loop is compiled to vector instructions.
            value = 1 + y * (1 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120)))))
            for _ in range(_SQUARINGS):
                value *= value
            affinity[i, j] = value if row[SAMPLES, j] >= COMPARABLE_SAMPLES else INCOMPARABLE


@compiled(fastmath={"contract"})
def combine_rows(matrix: Floats32, rows: Ints, factors: Floats, out: Floats) -> None:
    """Add some rows intp [m] of a matrix float32 [n, n], each times its factor float64 [m], to `out` [n]."""
    # Four rows a turn load and store the sums a quarter as often.
    fours = len(rows) // 4 * 4
    for k in range(0, fours, 4):
        a, b, c, d = matrix[rows[k]], matrix[rows[k + 1]], matrix[rows[k + 2]], matrix[rows[k + 3]]
        p, q, r, s = factors[k], factors[k + 1], factors[k + 2], factors[k + 3]
        for j in range(len(out)):
            out[j] += (p * a[j] + q * b[j]) + (r * c[j] + s * d[j])
    for k in range(fours, len(rows)):
        last, factor = matrix[rows[k]], factors[k]
        for j in range(len(out)):
            out[j] += factor * last[j]


@compiled()
def holds_weak_edge(matrix: Floats32, members: Ints, stop: float) -> bool:
    """Whether an affinity, float32 [n, n], of two members, intp [m], is at most `stop`."""
    for k in range(1, len(members)):
        row = matrix[members[k]]
        for other in range(k):
            if row[members[other]] <= stop:
                return True
    return False
