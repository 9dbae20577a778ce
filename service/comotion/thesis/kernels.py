"""Compiled: what trajectories are at some instants, and one pass of that over the sums of all pairs.

The twin in NumPy is :mod:`comotion.thesis.equations`: what is summed is (3.3) over the set (3.5), and what
comes out is (3.4). 128 consecutive rows are a strip, and two strips make a block of
128 x 128 pairs. The blocks of the lower triangle lie one after the other, so that a pass goes through memory
once, however many instants it brings, and more trajectories append blocks.
"""

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
# No affinity is smaller than exp(-40): products with less would be subnormal, and a hundred times as slow.
_LEAST_LOG = -40.0


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
    sums: Floats, samples: Floats, signs: Floats, present: Bools, rate: float, place: Slots, out: Floats32
) -> None:
    """Take samples into the sums of all blocks, and write the affinities that follow.

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
        intp [rows], row and column of `out` for each row, -1 for none; float32 [n, n], symmetric: 0.5 for
        pairs with fewer than two samples. Empty for no affinities.
    """
    for n in numba_range(len(samples) * (len(samples) + 1) // 2):
        row = int((np.sqrt(8.0 * n + 1.0) - 1.0) / 2.0)
        column = n - row * (row + 1) // 2
        affinities = np.empty((STRIP, STRIP), np.float32)
        for i in range(STRIP):
            for t in range(len(signs)):
                plane = _counting(samples[row, t], i)
                if samples[row, t, HELD, i] != 0.0 and present[column, t, plane]:
                    _add_sample(sums[n], i, samples[row, t], samples[column, t], plane, signs[t])
            if len(out):
                _compare(sums[n], i, rate, affinities[i])
        if len(out):
            mine = place[row * STRIP : (row + 1) * STRIP]
            theirs = place[column * STRIP : (column + 1) * STRIP]
            _write(affinities, mine, theirs, out)
            _write(affinities.T, theirs, mine, out)


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
def _add_sample(block: Floats, i: int, mine: Floats, theirs: Floats, counting: int, sign: float) -> None:
    """Add the samples of row i at an instant to its sums."""
    x, y, z, weight, counts = mine[X, i], mine[Y, i], mine[Z, i], mine[WEIGHT, i], theirs[counting]
    weights, first, second, samples = block[WEIGHTS, i], block[FIRST, i], block[SECOND, i], block[SAMPLES, i]
    for j in range(STRIP):
        dx, dy, dz = x - theirs[X, j], y - theirs[Y, j], z - theirs[Z, j]
        d = np.sqrt(dx * dx + dy * dy + dz * dz)
        # w of (3.2) grows with v: the larger of two weights is that of the larger speed.
        w = sign * counts[j] * max(weight, theirs[WEIGHT, j])
        weights[j] += w
        first[j] += w * d
        second[j] += w * d * d
        samples[j] += sign * counts[j]


@compiled(fastmath={"contract"})
def _compare(block: Floats, i: int, rate: float, affinities: Floats32) -> None:
    """(3.4), exp(−γσ²) with σ² of (3.3), of the pairs of row i."""
    for j in range(STRIP):
        eta = 1.0 / block[WEIGHTS, i, j]
        mean = eta * block[FIRST, i, j]
        variance = max(eta * block[SECOND, i, j] - mean * mean, 0.0)
        # exp(x) = exp(x / 64)^64, with six terms of the series: to 1e-7 where the affinity is above 1e-4.
        x = max(rate * variance, _LEAST_LOG) / 64
        y = 1 + x * (1 + x / 2 * (1 + x / 3 * (1 + x / 4 * (1 + x / 5 * (1 + x / 6)))))
        y = y * y
        y = y * y
        y = y * y
        y = y * y
        y = y * y
        y = y * y
        affinities[j] = y if block[SAMPLES, i, j] >= COMPARABLE_SAMPLES else INCOMPARABLE


@compiled()
def _write(affinities: Floats32, mine: Slots, theirs: Slots, out: Floats32) -> None:
    """Write the affinities of two strips where they belong."""
    for i in range(STRIP):
        for j in range(STRIP if mine[i] >= 0 else 0):
            if theirs[j] >= 0:
                out[mine[i], theirs[j]] = affinities[i, j]


@compiled()
def sum_inside(affinity: Floats32, members: Slots, stop: float, sums: Floats) -> bool:
    """Whether all affinities [n, n] of some members, intp [m], are above `stop`.

    If so, the sums of their affinities to each other stand in their places of sums, float64 [n].
    """
    for i in members:
        total = 0.0
        for j in members:
            if affinity[i, j] <= stop:
                return False
            total += affinity[i, j]
        sums[i] = total
    return True
