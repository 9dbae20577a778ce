"""Weighted sums over the distance samples of every pair of trajectories: (3.3) without its history.

The pairs lie in square tiles of the lower triangle, so that an update goes once through memory, however
many instants it brings, and more trajectories append tiles. The sums are single precision about a shift:
what they lose is far below what an affinity shows, and :class:`~comotion.pairs.Pairs` sums anew what
has lost more.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .compiled import compiled, numba_range, threads_for
from .samples import TILE, Array, Samples
from .window import Floats, Slots

_PLANES = 5
_SHIFT, _WEIGHT, _FIRST, _SECOND, _SAMPLES = range(_PLANES)
_MIN_SAMPLES = 2
# A tile whose largest sum of squares falls below this share of what it has been is mostly rounding.
_SOUND = 1e-4
# Rounding of a variance that is let be, in units of sigma_switch².
_TOLERATED = 0.01
# Where a recount has not helped, the next waits for so long: 4 = 0.99^-138 updates.
_PATIENCE = 0.99
# Below this share of its sum of squares, a variance has few digits left of float64.
_DIGITS = 1e-9
# 2^f on -1..0 as 1 + f·P(f), from Chebyshev interpolation: within 4e-9.
_FIT = np.polynomial.Chebyshev.interpolate(lambda f: np.expm1(f * np.log(2)) / f, 5, domain=[-1, 0])
_P1, _P2, _P3, _P4, _P5, _P6 = _FIT.convert(kind=np.polynomial.Polynomial).coef.astype(np.float32)
_ZERO, _ONE = np.float32(0), np.float32(1)
# That of a pair that cannot be compared is -1: an affinity of 0.5.
# Nothing is smaller than 1e-18: products with less would be subnormal, and a hundred times as slow.
_LEAST_POWER = np.float32(-60)
_ENOUGH = np.float32(_MIN_SAMPLES)


class PairSums:
    """Per pair of places: number of samples, and sums of w, w·d' and w·d'² with d' = d − shift.

    The shift is the distance when the pair began: about zero, E[d²] − E[d]² would cancel.

    Parameters
    ----------
    dtype
        float32, or float64 for twice the memory and every digit.
    """

    def __init__(self, dtype: type[np.floating[Any]] = np.float32) -> None:
        self.dtype = np.dtype(dtype)
        self.blocks = 0
        self._tiles: Array = np.zeros((0, _PLANES, TILE, TILE), dtype)
        self._peak: Floats = np.zeros(0)
        # Largest squared distance of a mean from its shift when the tile was last recounted.
        self._settled: Floats = np.zeros(0)

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return int(_triangle(self.blocks))

    def fit(self, blocks: int) -> None:
        """Make room for `blocks` times TILE places."""
        if blocks <= self.blocks:
            return
        self.blocks = blocks
        if self.tiles > len(self._tiles):
            # A quarter more at once: growing copies everything.
            room = int(_triangle(blocks + blocks // 8))
            grown = np.zeros((room, *self._tiles.shape[1:]), self.dtype)
            grown[: len(self._tiles)] = self._tiles
            self._tiles = grown
            extra = room - len(self._peak)
            self._peak, self._settled = np.pad(self._peak, (0, extra)), np.pad(self._settled, (0, extra))

    def add(self, samples: Samples) -> Slots:
        """Take samples into all tiles; answers which tiles are mostly rounding now, intp [k]."""
        return self._pass(samples, 0.0, np.zeros((0, 0), np.float32))

    def add_and_compare(self, samples: Samples, sigma_switch: float, out: NDArray[np.float32]) -> Slots:
        """As :meth:`add`, and write the affinities (3.4) of all pairs on the way.

        Parameters
        ----------
        samples
            What to take in.
        sigma_switch
            Standard deviation at which the affinity is 0.5.
        out
            float32 [places, places], written at and below the diagonal: 0.5 for pairs with fewer than two
            samples.
        """
        return self._pass(samples, -1.0 / sigma_switch**2, out)

    def compare(self, tiles: Slots, sigma_switch: float, out: NDArray[np.float32]) -> None:
        """Write the affinities of some tiles again."""
        nothing = Samples.none(self.blocks * TILE, self.dtype)
        _, self._settled[tiles] = self._advance(tiles, nothing, -1.0 / sigma_switch**2, out)

    def _pass(self, samples: Samples, rate: float, out: NDArray[np.float32]) -> Slots:
        most, reach = self._advance(np.arange(self.tiles), samples, rate, out)
        peak, settled = self._peak[: self.tiles], self._settled[: self.tiles]
        np.maximum(peak, most, out=peak)
        rounded = most < _SOUND * peak
        if rate and self.tiles:
            # Far from the shift, squares cancel. A recount takes another shift, one tile at a time.
            settled *= _PATIENCE
            worst = int(reach.argmax())
            limit = _TOLERATED / (-rate * np.finfo(self.dtype).eps)
            rounded[worst] |= reach[worst] > max(limit, 4 * settled[worst])
        return np.flatnonzero(rounded)

    def _advance(
        self, tiles: Slots, samples: Samples, rate: float, out: NDArray[np.float32]
    ) -> tuple[Floats, Floats]:
        rows, columns = _blocks_of(tiles)
        where = tiles, rows * TILE, columns * TILE
        with threads_for(len(tiles) * TILE**2):
            most, reach = _advance(self._tiles, *where, *samples.arrays(), self.dtype.type(rate), out)
        return most, reach

    def recount(self, tile: int) -> tuple[int, int]:
        """Empty a tile, to be filled by :meth:`add_to`; answers its two blocks."""
        self._tiles[tile] = 0
        self._peak[tile] = 0
        row, column = _blocks_of(np.array([tile]))
        return int(row[0]), int(column[0])

    def add_to(self, tile: int, samples: Samples) -> None:
        """Take samples into one tile; their first TILE places are its rows, their last its columns."""
        where = np.array([tile]), np.zeros(1, np.intp), np.array([samples.places - TILE])
        nowhere = np.zeros((0, 0), np.float32)
        with threads_for(TILE**2):
            most, _ = _advance(self._tiles, *where, *samples.arrays(), self.dtype.type(0), nowhere)
        self._peak[tile] = max(self._peak[tile], most[0])

    def forget(self, places: Slots) -> None:
        """Drop all samples of some places."""
        for place in places.tolist():
            block, inside = divmod(place, TILE)
            first = _triangle(block)
            self._tiles[first : first + block + 1, 1:, inside, :] = 0
            below = np.arange(block, self.blocks)
            self._tiles[_triangle(below) + block, 1:, :, inside] = 0

    def read(self, places: Slots) -> tuple[Floats, NDArray[np.int64], Slots]:
        """Variance (3.3) and number of samples of each pair, [n, n] each; tiles too rounded to tell."""
        high, low = np.maximum.outer(places, places), np.minimum.outer(places, places)
        tile = _triangle(high // TILE) + low // TILE
        found = self._tiles[tile, :, high % TILE, low % TILE].astype(np.float64)
        weight, first, second, samples = (found[..., k] for k in range(1, _PLANES))
        enough = samples >= _MIN_SAMPLES
        weight = np.where(enough, weight, 1.0)
        squares = second - first**2 / weight
        rounded = np.unique(tile[enough & (squares < _DIGITS * second)])
        return np.where(enough, np.maximum(squares, 0.0) / weight, 0.0), samples.astype(np.int64), rounded


def _triangle(blocks: Any) -> Any:
    return blocks * (blocks + 1) // 2


def _blocks_of(tiles: Slots) -> tuple[Slots, Slots]:
    """Rows and columns of tiles, counted in blocks."""
    row = ((np.sqrt(8 * tiles + 1) - 1) // 2).astype(np.intp)
    return row, tiles - _triangle(row)


@compiled(parallel=True, fastmath={"contract"})
def _advance(
    sums: Array,
    tiles: Slots,
    rows: Slots,
    columns: Slots,
    position: Array,
    weight: Array,
    kind: Array,
    mask: Array,
    some: Array,
    rate: np.floating[Any],
    out: Array,
) -> tuple[Floats, Floats]:
    """Take samples into tiles, write what they say then; per tile the largest sum and mean of squares."""
    most, reach = np.zeros(len(tiles)), np.zeros(len(tiles))
    for n in numba_range(len(tiles)):
        tile, row, column = sums[tiles[n]], rows[n], columns[n]
        change = np.empty((_PLANES, TILE), sums.dtype)
        chosen = np.empty(len(kind), np.int64)
        bits = np.empty(TILE, np.int32)
        largest, farthest = np.zeros(TILE, sums.dtype), np.zeros(TILE, sums.dtype)
        for i in range(TILE):
            count = _choose(kind[:, row + i], some[:, :, column // TILE], chosen)
            if count:
                _collect(tile, i, row, column, position, weight, kind, mask, chosen[:count], change)
            for j in range(TILE):
                largest[j] = max(largest[j], tile[_SECOND, i, j])
            if len(out):
                _affinities(tile, i, rate, out[row + i, column : column + TILE], bits, farthest)
        most[n], reach[n] = largest.max(), farthest.max()
    return most, reach


@compiled()
def _choose(kinds: Array, some: Array, chosen: Array) -> int:
    """Which instants have a sample of a place with any of a block; how many."""
    count = 0
    for t in range(len(kinds)):
        if kinds[t] >= 0 and some[t, kinds[t]]:
            chosen[count] = t
            count += 1
    return count


@compiled(fastmath={"contract"})
def _collect(
    tile: Array,
    i: int,
    row: int,
    column: int,
    position: Array,
    weight: Array,
    kind: Array,
    mask: Array,
    chosen: Array,
    change: Array,
) -> None:
    """Add the samples of row i at some instants to the sums of a tile."""
    fresh = False
    for j in range(TILE):
        fresh |= tile[_SAMPLES, i, j] == _ZERO
    if fresh:
        _begin(tile, i, row, column, position, kind, mask, chosen)
    for plane in range(1, _PLANES):
        for j in range(TILE):
            change[plane, j] = _ZERO
    shift = tile[_SHIFT, i]
    for t in chosen:
        x, y, z = position[t, 0, row + i], position[t, 1, row + i], position[t, 2, row + i]
        w = weight[t, row + i]
        xs = position[t, 0, column : column + TILE]
        ys = position[t, 1, column : column + TILE]
        zs = position[t, 2, column : column + TILE]
        ws, ms = weight[t, column : column + TILE], mask[t, kind[t, row + i], column : column + TILE]
        for j in range(TILE):
            dx, dy, dz = x - xs[j], y - ys[j], z - zs[j]
            distance = np.sqrt(dx * dx + dy * dy + dz * dz) - shift[j]
            # w is monotonic in v, so the faster of two has the larger.
            share = max(w, ws[j]) * ms[j]
            first = share * distance
            change[_WEIGHT, j] += share
            change[_FIRST, j] += first
            change[_SECOND, j] += first * distance
            change[_SAMPLES, j] += ms[j]
    for plane in range(1, _PLANES):
        for j in range(TILE):
            tile[plane, i, j] += change[plane, j]


@compiled(fastmath={"contract"})
def _begin(
    tile: Array, i: int, row: int, column: int, position: Array, kind: Array, mask: Array, chosen: Array
) -> None:
    """Start the pairs of row i that have no sample: the first distance is the shift."""
    for j in range(TILE):
        if tile[_SAMPLES, i, j] != _ZERO:
            continue
        for plane in range(1, _PLANES):
            tile[plane, i, j] = _ZERO
        for t in chosen:
            if mask[t, kind[t, row + i], column + j] > _ZERO:
                dx = position[t, 0, row + i] - position[t, 0, column + j]
                dy = position[t, 1, row + i] - position[t, 1, column + j]
                dz = position[t, 2, row + i] - position[t, 2, column + j]
                tile[_SHIFT, i, j] = np.sqrt(dx * dx + dy * dy + dz * dz)
                break


@compiled(fastmath={"contract"})
def _affinities(
    tile: Array, i: int, rate: np.floating[Any], values: Array, bits: Array, farthest: Array
) -> None:
    """(3.4) of row i: exp(−γσ²) is 2 to the power of −σ²/sigma_switch²."""
    for j in range(TILE):
        comparable = tile[_SAMPLES, i, j] >= _ENOUGH
        over = _ONE / tile[_WEIGHT, i, j]
        mean = tile[_FIRST, i, j] * over
        farthest[j] = max(farthest[j], mean * mean if comparable else _ZERO)
        variance = max((tile[_SECOND, i, j] - tile[_FIRST, i, j] * mean) * over, _ZERO)
        power = np.float32(max(rate * variance, _LEAST_POWER)) if comparable else -_ONE
        whole = np.int32(power)
        part = power - np.float32(whole)
        share = _P5 + part * _P6
        share = _P4 + part * share
        share = _P3 + part * share
        share = _P2 + part * share
        share = _P1 + part * share
        values[j] = _ONE + part * share
        # The bits of the exponent of a single precision number.
        bits[j] = (whole + np.int32(127)) << np.int32(23)
    scale = bits.view(np.float32)
    for j in range(TILE):
        values[j] = min(values[j] * scale[j], _ONE)
