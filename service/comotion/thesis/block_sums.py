"""Sums over every pair of trajectories, and affinities from them: (3.3) and (3.4) without the history.

Each trajectory has a row. 64 consecutive rows are a strip, and two strips make a block of 64 x 64 pairs. The
blocks of the lower triangle lie one after the other, so that an update goes through memory once, however
many instants it brings, and more trajectories append blocks. The sums are single precision about a shift.
What that loses is far below what an affinity shows, and :class:`~comotion.thesis.pair_sums.PairSums`
computes the sums of a block that has lost more again.
"""

import math
from typing import Any

import numpy as np

from ..arrays import Floats, Floats32, Slots, aligned_zeros
from ..compiled import worth_waking
from .equations import AFFINITY_AT_SWITCH
from .kernels import PLANES, STRIP, Array, update_blocks
from .samples import SampleBuffer

# A block whose largest Σwd'² falls below this share of its peak: what single precision (6e-8) has lost at the
# peak is up to 1e-3 of what is left.
_PRECISE_SHARE = 1e-4
# Rounding of a variance up to which a block is left alone, in units of sigma_switch²: 0.7 % of an affinity.
_TOLERATED_ROUNDING = 0.01
# The mean of d' grows back after another shift, in some pairs at once. A block that has been recomputed for
# it waits until the mean square has grown by this factor over what it was right afterwards; that value decays
# by the second number at each update, so that the wait ends after 138 updates in any case.
_GROWTH, _DECAY = 4.0, 0.99

_NOWHERE, _NO_AFFINITIES = np.zeros(0, np.intp), np.zeros((0, 0), np.float32)


class BlockSums:
    """Per pair of rows: number of samples, and sums of w, w·d' and w·d'² with d' = d − shift.

    The shift is the distance when the pair began: with a shift of zero, E[d²] − E[d]² would cancel.

    Parameters
    ----------
    dtype
        float32, or float64 for twice the memory and all digits.

    Attributes
    ----------
    strips
        Number of strips.
    sums
        `dtype` [blocks or more, PLANES, STRIP, STRIP]: block ``r * (r + 1) / 2 + c`` has the rows of strip r
        and, as columns, those of strip c <= r.
    """

    def __init__(self, dtype: type[np.floating[Any]] = np.float32) -> None:
        self.dtype = np.dtype(dtype)
        self.strips = 0
        self.sums: Array = aligned_zeros((0, PLANES, STRIP, STRIP), dtype)
        # Of each block: the largest Σwd'² since it was last emptied, and the largest squared mean of d' right
        # after it was last recomputed.
        self._peak: Floats = np.zeros(0)
        self._settled: Floats = np.zeros(0)

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(_triangle(self.strips))

    def fit(self, strips: int) -> None:
        """Hold so many strips."""
        if strips <= self.strips:
            return
        self.strips = strips
        if self.blocks > len(self.sums):
            # A quarter more at once: growing copies everything.
            blocks = int(_triangle(strips + strips // 8))
            grown = aligned_zeros((blocks, *self.sums.shape[1:]), self.dtype)
            grown[: len(self.sums)] = self.sums
            self.sums = grown
            extra = blocks - len(self._peak)
            self._peak, self._settled = np.pad(self._peak, (0, extra)), np.pad(self._settled, (0, extra))

    def add(self, samples: SampleBuffer) -> None:
        """Take samples into all blocks."""
        blocks = np.arange(self.blocks)
        self._update((blocks, *_strips_of(blocks)), samples)

    def add_and_compare(
        self, samples: SampleBuffer, sigma_switch: float, place: Slots, out: Floats32
    ) -> Slots:
        """Take samples into all blocks and write the logarithms of the affinities (3.4) of all pairs.

        Parameters
        ----------
        samples
            What to take in.
        sigma_switch
            Standard deviation at which the affinity is 0.5.
        place
            intp [rows]: row and column of `out` that each row is written to, -1 for none.
        out
            float32 [n, n], symmetric: log(0.5) for pairs with fewer than two samples.

        Returns
        -------
        NDArray[intp]
            Blocks that have lost too many digits and should be recomputed.
        """
        blocks = np.arange(self.blocks)
        rate = _log_rate(sigma_switch)
        largest, reach = self._update((blocks, *_strips_of(blocks)), samples, rate, place, out)
        peak, settled = self._peak[: self.blocks], self._settled[: self.blocks]
        imprecise = largest < _PRECISE_SHARE * peak
        if self.blocks:
            # Far from the shift, squares cancel. Recomputed sums have another shift, one block at a time.
            settled *= _DECAY
            worst = int(reach.argmax())
            limit = _TOLERATED_ROUNDING * sigma_switch**2 / np.finfo(self.dtype).eps
            imprecise[worst] |= reach[worst] > max(limit, _GROWTH * settled[worst])
        return np.flatnonzero(imprecise)

    def compare(self, blocks: Slots, sigma_switch: float, place: Slots, out: Floats32) -> None:
        """Write the logarithms of some blocks again, after they have been recomputed."""
        nothing = SampleBuffer(self.strips, self.dtype, capacity=0)
        where = blocks, *_strips_of(blocks)
        _, self._settled[blocks] = self._update(where, nothing, _log_rate(sigma_switch), place, out)

    def empty(self, block: int) -> tuple[int, int]:
        """Empty a block, for :meth:`add_to` to fill; returns the strips of its rows and its columns."""
        self.sums[block] = 0
        self._peak[block] = 0
        row, column = _strips_of(np.array([block]))
        return int(row[0]), int(column[0])

    def add_to(self, block: int, samples: SampleBuffer) -> None:
        """Take samples into one block, whose rows are their first strip and whose columns their last."""
        self._update((np.array([block]), np.zeros(1, np.intp), np.array([samples.strips - 1])), samples)

    def forget(self, rows: Slots) -> None:
        """Drop all samples of some rows."""
        for row in rows.tolist():
            strip, inside = divmod(row, STRIP)
            first = _triangle(strip)
            self.sums[first : first + strip + 1, 1:, inside, :] = 0
            below = np.arange(strip, self.strips)
            self.sums[_triangle(below) + strip, 1:, :, inside] = 0

    def _update(
        self,
        where: tuple[Slots, Slots, Slots],
        samples: SampleBuffer,
        rate: float = 0.0,
        place: Slots = _NOWHERE,
        out: Floats32 = _NO_AFFINITIES,
    ) -> tuple[Floats, Floats]:
        """Call :func:`update_blocks`, and note the peaks."""
        arrays = samples.values, samples.status, samples.any_partner
        compare = self.dtype.type(rate), place, out
        shared = worth_waking(len(where[0]) * STRIP**2)
        largest, reach = update_blocks(self.sums, *where, *arrays, samples.count, *compare, shared)
        self._peak[where[0]] = np.maximum(self._peak[where[0]], largest)
        return largest, reach


def _log_rate(sigma_switch: float) -> float:
    """−γ of (3.4)."""
    return math.log(AFFINITY_AT_SWITCH) / sigma_switch**2


def _triangle(strips: Any) -> Any:
    return strips * (strips + 1) // 2


def _strips_of(blocks: Slots) -> tuple[Slots, Slots]:
    """Strips of the rows and of the columns of blocks."""
    row = ((np.sqrt(8 * blocks + 1) - 1) // 2).astype(np.intp)
    return row, blocks - _triangle(row)
