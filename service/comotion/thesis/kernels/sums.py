"""Compiled: samples into the sums of all pairs, affinities out, one block of pairs in the cache at a time.

A block holds the pairs of two strips of rows. The twin in NumPy is :mod:`comotion.thesis.equations`: the sums
are those of (3.3) over the set (3.5), and what comes out is (3.4).
"""

from typing import Any

import numpy as np

from ...arrays import Floats, Slots
from ...compiled import compiled, numba_range
from .samples import SIGN, STRIP, WEIGHT, Array

PLANES = 5
SHIFT, WEIGHTS, FIRST, SECOND, SAMPLES = range(PLANES)
"""What a block holds of each pair: a shift, Σw, Σwd', Σwd'² with d' = d − shift, and how many samples."""
COMPARABLE_SAMPLES = 2
"""Samples from which on a pair can be compared: one has no variance."""
# 2^f on -1..0 as 1 + f·P(f), from Chebyshev interpolation: within 4e-9.
_FIT = np.polynomial.Chebyshev.interpolate(lambda f: np.expm1(f * np.log(2)) / f, 5, domain=[-1, 0])
_P1, _P2, _P3, _P4, _P5, _P6 = _FIT.convert(kind=np.polynomial.Polynomial).coef.astype(np.float32)
_ZERO, _ONE = np.float32(0), np.float32(1)
# No affinity is smaller than 2^-60: products with less would be subnormal, and a hundred times as slow.
_LEAST_POWER = np.float32(-60)
_COMPARABLE = np.float32(COMPARABLE_SAMPLES)
# 2^-1, the affinity of a pair that cannot be compared.
_HALF_POWER = np.float32(-1)
# IEEE 754 single precision: the bias of the exponent, and its lowest bit.
_BIAS, _EXPONENT = np.float32(127), np.float32(2**23)


@compiled(parallel=True, fastmath={"contract"})
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
    out: Array,
    shared: bool,
) -> tuple[Floats, Floats]:
    """Take samples into the sums of blocks, and write the affinities that follow.

    Parameters
    ----------
    sums
        [blocks, PLANES, STRIP, STRIP].
    blocks, rows, columns
        intp [k]: blocks, and the strips that are their rows and columns.
    values, status, any_partner, count
        Attributes of :class:`~comotion.thesis.sample_buffer.SampleBuffer`.
    rate
        -1 / sigma_switch²: the binary logarithm of (3.4) is rate · σ².
    out
        float32 [rows, rows] for affinities, written at and below the diagonal; or empty, for none.
    shared
        Whether all threads share the work.

    Returns
    -------
    most, reach
        float64 [k]: per block the largest Σwd'², and the largest square of a mean of d'.
    """
    most, reach = np.zeros(len(blocks)), np.zeros(len(blocks))
    samples = values, status, any_partner
    if shared:
        for n in numba_range(len(blocks)):
            where = rows[n], columns[n]
            most[n], reach[n] = _update_block(sums[blocks[n]], where, samples, count, rate, out)
    else:
        for n in range(len(blocks)):
            where = rows[n], columns[n]
            most[n], reach[n] = _update_block(sums[blocks[n]], where, samples, count, rate, out)
    return most, reach


@compiled(fastmath={"contract"})
def _update_block(
    block: Array,
    where: tuple[int, int],
    samples: tuple[Array, Array, Array],
    count: int,
    rate: np.floating[Any],
    out: Array,
) -> tuple[float, float]:
    row, column = where
    values, status, any_partner = samples
    mine, theirs = values[row], values[column]
    change = np.empty((PLANES, STRIP), block.dtype)
    chosen = np.empty(count, np.int64)
    bits = np.empty(STRIP, np.int32)
    largest, farthest = np.zeros(STRIP, block.dtype), np.zeros(STRIP, block.dtype)
    for i in range(STRIP):
        found = _choose_instants(status[row], i, any_partner[column], chosen)
        if found:
            _add_up(block, i, mine, theirs, status[row], chosen[:found], change)
            _settle(block, i, mine, theirs, status[row], chosen[:found], change)
        for j in range(STRIP):
            largest[j] = max(largest[j], block[SECOND, i, j])
        if len(out):
            _affinities(
                block, i, rate, out[row * STRIP + i, column * STRIP : (column + 1) * STRIP], bits, farthest
            )
    return largest.max(), farthest.max()


@compiled()
def _choose_instants(status: Array, i: int, any_partner: Array, chosen: Array) -> int:
    """Fill `chosen`: instants at which row i has a sample with any row of the other strip; how many."""
    found = 0
    for t in range(len(chosen)):
        if status[t, i] >= 0 and any_partner[t, status[t, i]]:
            chosen[found] = t
            found += 1
    return found


@compiled(fastmath={"contract"})
def _add_up(
    block: Array, i: int, mine: Array, theirs: Array, status: Array, chosen: Array, change: Array
) -> None:
    """Fill `change`: what the samples of row i add to its sums, two instants at a time (a tenth faster)."""
    for plane in range(1, PLANES):
        for j in range(STRIP):
            change[plane, j] = _ZERO
    shift, count = block[SHIFT, i], len(chosen)
    for m in range(0, count, 2):
        t, u = chosen[m], chosen[min(m + 1, count - 1)]
        # The last of an odd number is taken twice, the second time with sign 0.
        also = _ONE if m + 1 < count else _ZERO
        xt, yt, zt, wt = mine[t, 0, i], mine[t, 1, i], mine[t, 2, i], mine[t, WEIGHT, i]
        xu, yu, zu, wu = mine[u, 0, i], mine[u, 1, i], mine[u, 2, i], mine[u, WEIGHT, i]
        a, b, sa, sb = theirs[t], theirs[u], SIGN + status[t, i], SIGN + status[u, i]
        for j in range(STRIP):
            dx, dy, dz = xt - a[0, j], yt - a[1, j], zt - a[2, j]
            ex, ey, ez = xu - b[0, j], yu - b[1, j], zu - b[2, j]
            dt = np.sqrt(dx * dx + dy * dy + dz * dz) - shift[j]
            du = np.sqrt(ex * ex + ey * ey + ez * ez) - shift[j]
            # w of (3.2) grows with v: the larger of two weights is that of the larger speed.
            sign = b[sb, j] * also
            w, v = max(wt, a[WEIGHT, j]) * a[sa, j], max(wu, b[WEIGHT, j]) * sign
            change[WEIGHTS, j] += w + v
            change[FIRST, j] += w * dt + v * du
            change[SECOND, j] += w * dt * dt + v * du * du
            change[SAMPLES, j] += a[sa, j] + sign


@compiled(fastmath={"contract"})
def _settle(
    block: Array, i: int, mine: Array, theirs: Array, status: Array, chosen: Array, change: Array
) -> None:
    """Add `change` to the sums of row i; pairs without a sample so far begin."""
    begun = _ZERO
    for j in range(STRIP):
        begun = max(begun, change[SAMPLES, j] if block[SAMPLES, i, j] == _ZERO else _ZERO)
    if begun:
        for j in range(STRIP):
            if block[SAMPLES, i, j] == _ZERO and change[SAMPLES, j] > _ZERO:
                _begin(block, i, j, mine, theirs, status, chosen, change)
    for plane in range(1, PLANES):
        for j in range(STRIP):
            block[plane, i, j] += change[plane, j]


@compiled(fastmath={"contract"})
def _begin(
    block: Array, i: int, j: int, mine: Array, theirs: Array, status: Array, chosen: Array, change: Array
) -> None:
    """Begin a pair: its first distance is the shift, about which the samples are added up again."""
    for plane in range(1, PLANES):
        block[plane, i, j] = _ZERO
        change[plane, j] = _ZERO
    begun = False
    for t in chosen:
        sign = theirs[t, SIGN + status[t, i], j]
        dx = mine[t, 0, i] - theirs[t, 0, j]
        dy = mine[t, 1, i] - theirs[t, 1, j]
        dz = mine[t, 2, i] - theirs[t, 2, j]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if not begun and sign > _ZERO:
            block[SHIFT, i, j] = distance
            begun = True
        share = max(mine[t, WEIGHT, i], theirs[t, WEIGHT, j]) * sign
        distance -= block[SHIFT, i, j]
        change[WEIGHTS, j] += share
        change[FIRST, j] += share * distance
        change[SECOND, j] += share * distance * distance
        change[SAMPLES, j] += sign


@compiled(fastmath={"contract"})
def _affinities(
    block: Array, i: int, rate: np.floating[Any], values: Array, bits: Array, farthest: Array
) -> None:
    """(3.4) of row i: exp(−γσ²) is 2 to the power of −σ²/sigma_switch²."""
    for j in range(STRIP):
        comparable = block[SAMPLES, i, j] >= _COMPARABLE
        over = _ONE / block[WEIGHTS, i, j]
        mean = block[FIRST, i, j] * over
        farthest[j] = max(farthest[j], mean * mean if comparable else _ZERO)
        variance = max((block[SECOND, i, j] - block[FIRST, i, j] * mean) * over, _ZERO)
        power = np.float32(max(rate * variance, _LEAST_POWER)) if comparable else _HALF_POWER
        whole = np.trunc(power)
        part = power - whole
        share = _P5 + part * _P6
        share = _P4 + part * share
        share = _P3 + part * share
        share = _P2 + part * share
        share = _P1 + part * share
        values[j] = _ONE + part * share
        # The bits of the exponent of a single precision number; integers would be added in 64 bits.
        bits[j] = np.int32((whole + _BIAS) * _EXPONENT)
    scale = bits.view(np.float32)
    for j in range(STRIP):
        values[j] = min(values[j] * scale[j], _ONE)
