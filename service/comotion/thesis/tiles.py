"""The pass over tiles of sums of pairs: samples in, affinities out, one tile in the cache at a time."""

from typing import Any

import numpy as np

from ..arrays import Floats, Slots
from ..compiled import compiled, numba_range
from .samples import MASK, TILE, WEIGHT, Array

PLANES = 5
SHIFT, WEIGHTS, FIRST, SECOND, SAMPLES = range(PLANES)
"""What a tile holds of each pair: a shift, Σw, Σwd', Σwd'² with d' = d − shift, and how many samples."""
ENOUGH = 2
"""Samples from which on a pair can be compared."""
# 2^f on -1..0 as 1 + f·P(f), from Chebyshev interpolation: within 4e-9.
_FIT = np.polynomial.Chebyshev.interpolate(lambda f: np.expm1(f * np.log(2)) / f, 5, domain=[-1, 0])
_P1, _P2, _P3, _P4, _P5, _P6 = _FIT.convert(kind=np.polynomial.Polynomial).coef.astype(np.float32)
_ZERO, _ONE = np.float32(0), np.float32(1)
# That of a pair that cannot be compared is -1: an affinity of 0.5.
# Nothing is smaller than 1e-18: products with less would be subnormal, and a hundred times as slow.
_LEAST_POWER = np.float32(-60)
_ENOUGH = np.float32(ENOUGH)
_BIAS, _EXPONENT = np.float32(127), np.float32(2**23)


@compiled(parallel=True, fastmath={"contract"})
def advance(
    sums: Array,
    tiles: Slots,
    rows: Slots,
    columns: Slots,
    values: Array,
    kind: Array,
    some: Array,
    count: int,
    rate: np.floating[Any],
    out: Array,
    together: bool,
) -> tuple[Floats, Floats]:
    """Take samples into tiles, write what they say then.

    Parameters
    ----------
    sums
        [tiles, PLANES, TILE, TILE].
    tiles, rows, columns
        intp [k]: tiles, and the blocks of places that are their rows and columns.
    values, kind, some, count
        Attributes of :class:`~comotion.thesis.samples.Samples`.
    rate
        -1 / sigma_switch².
    out
        float32 [places, places] for affinities, or with no rows.
    together
        Whether all threads share the work.

    Returns
    -------
    most, reach
        float64 [k]: per tile the largest Σwd'², and the largest square of a mean of d'.
    """
    most, reach = np.zeros(len(tiles)), np.zeros(len(tiles))
    samples = values, kind, some
    if together:
        for n in numba_range(len(tiles)):
            where = rows[n], columns[n]
            most[n], reach[n] = _advance_tile(sums[tiles[n]], where, samples, count, rate, out)
    else:
        for n in range(len(tiles)):
            where = rows[n], columns[n]
            most[n], reach[n] = _advance_tile(sums[tiles[n]], where, samples, count, rate, out)
    return most, reach


@compiled(fastmath={"contract"})
def _advance_tile(
    tile: Array,
    where: tuple[int, int],
    samples: tuple[Array, Array, Array],
    count: int,
    rate: np.floating[Any],
    out: Array,
) -> tuple[float, float]:
    row, column = where
    values, kind, some = samples
    mine, theirs = values[row], values[column]
    change = np.empty((PLANES, TILE), tile.dtype)
    chosen = np.empty(count, np.int64)
    bits = np.empty(TILE, np.int32)
    largest, farthest = np.zeros(TILE, tile.dtype), np.zeros(TILE, tile.dtype)
    for i in range(TILE):
        found = _choose(kind[row], i, some[column], chosen)
        if found:
            _sum_up(tile, i, mine, theirs, kind[row], chosen[:found], change)
            _settle(tile, i, mine, theirs, kind[row], chosen[:found], change)
        for j in range(TILE):
            largest[j] = max(largest[j], tile[SECOND, i, j])
        if len(out):
            _affinities(
                tile, i, rate, out[row * TILE + i, column * TILE : (column + 1) * TILE], bits, farthest
            )
    return largest.max(), farthest.max()


@compiled()
def _choose(kind: Array, i: int, some: Array, chosen: Array) -> int:
    """Which instants have a sample of a place with any of a block; how many."""
    found = 0
    for t in range(len(chosen)):
        if kind[t, i] >= 0 and some[t, kind[t, i]]:
            chosen[found] = t
            found += 1
    return found


@compiled(fastmath={"contract"})
def _sum_up(
    tile: Array, i: int, mine: Array, theirs: Array, kind: Array, chosen: Array, change: Array
) -> None:
    """What samples of row i at some instants add to the sums, two at a time: a tenth faster than one."""
    for plane in range(1, PLANES):
        for j in range(TILE):
            change[plane, j] = _ZERO
    shift, count = tile[SHIFT, i], len(chosen)
    for m in range(0, count, 2):
        t, u = chosen[m], chosen[min(m + 1, count - 1)]
        # The last of an odd number is its own second, which counts nothing.
        also = _ONE if m + 1 < count else _ZERO
        xt, yt, zt, wt = mine[t, 0, i], mine[t, 1, i], mine[t, 2, i], mine[t, WEIGHT, i]
        xu, yu, zu, wu = mine[u, 0, i], mine[u, 1, i], mine[u, 2, i], mine[u, WEIGHT, i]
        a, b, ma, mb = theirs[t], theirs[u], MASK + kind[t, i], MASK + kind[u, i]
        for j in range(TILE):
            dx, dy, dz = xt - a[0, j], yt - a[1, j], zt - a[2, j]
            ex, ey, ez = xu - b[0, j], yu - b[1, j], zu - b[2, j]
            dt = np.sqrt(dx * dx + dy * dy + dz * dz) - shift[j]
            du = np.sqrt(ex * ex + ey * ey + ez * ez) - shift[j]
            # w is monotonic in v, so the faster of two has the larger.
            mask = b[mb, j] * also
            w, v = max(wt, a[WEIGHT, j]) * a[ma, j], max(wu, b[WEIGHT, j]) * mask
            change[WEIGHTS, j] += w + v
            change[FIRST, j] += w * dt + v * du
            change[SECOND, j] += w * dt * dt + v * du * du
            change[SAMPLES, j] += a[ma, j] + mask


@compiled(fastmath={"contract"})
def _settle(
    tile: Array, i: int, mine: Array, theirs: Array, kind: Array, chosen: Array, change: Array
) -> None:
    """Add to the sums of row i what samples at some instants have added up to."""
    begun = _ZERO
    for j in range(TILE):
        begun = max(begun, change[SAMPLES, j] if tile[SAMPLES, i, j] == _ZERO else _ZERO)
    if begun:
        for j in range(TILE):
            if tile[SAMPLES, i, j] == _ZERO and change[SAMPLES, j] > _ZERO:
                _begin(tile, i, j, mine, theirs, kind, chosen, change)
    for plane in range(1, PLANES):
        for j in range(TILE):
            tile[plane, i, j] += change[plane, j]


@compiled(fastmath={"contract"})
def _begin(
    tile: Array, i: int, j: int, mine: Array, theirs: Array, kind: Array, chosen: Array, change: Array
) -> None:
    """Start a pair that has no sample: the first distance is the shift, about which it is summed again."""
    for plane in range(1, PLANES):
        tile[plane, i, j] = _ZERO
        change[plane, j] = _ZERO
    begun = False
    for t in chosen:
        mask = theirs[t, MASK + kind[t, i], j]
        dx = mine[t, 0, i] - theirs[t, 0, j]
        dy = mine[t, 1, i] - theirs[t, 1, j]
        dz = mine[t, 2, i] - theirs[t, 2, j]
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        if not begun and mask > _ZERO:
            tile[SHIFT, i, j] = distance
            begun = True
        share = max(mine[t, WEIGHT, i], theirs[t, WEIGHT, j]) * mask
        distance -= tile[SHIFT, i, j]
        change[WEIGHTS, j] += share
        change[FIRST, j] += share * distance
        change[SECOND, j] += share * distance * distance
        change[SAMPLES, j] += mask


@compiled(fastmath={"contract"})
def _affinities(
    tile: Array, i: int, rate: np.floating[Any], values: Array, bits: Array, farthest: Array
) -> None:
    """(3.4) of row i: exp(−γσ²) is 2 to the power of −σ²/sigma_switch²."""
    for j in range(TILE):
        comparable = tile[SAMPLES, i, j] >= _ENOUGH
        over = _ONE / tile[WEIGHTS, i, j]
        mean = tile[FIRST, i, j] * over
        farthest[j] = max(farthest[j], mean * mean if comparable else _ZERO)
        variance = max((tile[SECOND, i, j] - tile[FIRST, i, j] * mean) * over, _ZERO)
        power = np.float32(max(rate * variance, _LEAST_POWER)) if comparable else -_ONE
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
    for j in range(TILE):
        values[j] = min(values[j] * scale[j], _ONE)
