"""Weighted sums over the distance samples of every pair of trajectories: (3.3) without its history.

The pairs lie in square tiles of the lower triangle, so that an update goes once through memory, however
many instants it brings, and more trajectories append tiles. The sums are single precision about a shift:
what they lose is far below what an affinity shows, and :class:`~comotion.thesis.pairs.Pairs` sums anew what
has lost more.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..aligned import aligned_zeros
from ..arrays import Floats, Slots
from ..compiled import worth_waking
from .samples import TILE, Array, Samples
from .tiles import ENOUGH, PLANES, advance

# A tile whose largest sum of squares falls below this share of what it has been is mostly rounding.
_SOUND = 1e-4
# Rounding of a variance that is let be, in units of sigma_switch².
_TOLERATED = 0.01
# Where a recount has not helped, the next waits for so long: 4 = 0.99^-138 updates.
_PATIENCE = 0.99
# Below this share of its sum of squares, a variance has few digits left of float64.
_DIGITS = 1e-9


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
        self._tiles: Array = aligned_zeros((0, PLANES, TILE, TILE), dtype)
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
            grown = aligned_zeros((room, *self._tiles.shape[1:]), self.dtype)
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
        nothing = Samples(self.blocks, self.dtype, room=0)
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
        return self._apply((tiles, *_blocks_of(tiles)), samples, rate, out)

    def _apply(
        self, where: tuple[Slots, Slots, Slots], samples: Samples, rate: float, out: NDArray[np.float32]
    ) -> tuple[Floats, Floats]:
        arrays = samples.values, samples.kind, samples.some
        together = worth_waking(len(where[0]) * TILE**2)
        most, reach = advance(
            self._tiles, *where, *arrays, samples.count, self.dtype.type(rate), out, together
        )
        return most, reach

    def recount(self, tile: int) -> tuple[int, int]:
        """Empty a tile, to be filled by :meth:`add_to`; answers its two blocks."""
        self._tiles[tile] = 0
        self._peak[tile] = 0
        row, column = _blocks_of(np.array([tile]))
        return int(row[0]), int(column[0])

    def add_to(self, tile: int, samples: Samples) -> None:
        """Take samples into one tile; their first block is its rows, their last its columns."""
        where = np.array([tile]), np.zeros(1, np.intp), np.array([samples.blocks - 1])
        most, _ = self._apply(where, samples, 0.0, np.zeros((0, 0), np.float32))
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
        weight, first, second, samples = (found[..., k] for k in range(1, PLANES))
        enough = samples >= ENOUGH
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
