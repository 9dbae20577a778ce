"""Samples in, sums of every pair of trajectories and affinities out: (3.3) and (3.4) without the history.

Each trajectory has a row. 64 consecutive rows are a strip, and two strips make a block of 64 x 64 pairs. The
blocks of the lower triangle lie one after the other, so that an update goes through memory once, however
many instants it brings, and more trajectories append blocks. The sums are single precision about a shift.
What that loses is far below what an affinity shows, and :class:`~comotion.thesis.pair_sums.PairSums`
computes the sums of a block that has lost more again.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Slots, aligned_zeros
from ..compiled import worth_waking
from .kernels.samples import STRIP, Array
from .kernels.sums import PLANES, update_blocks
from .sample_buffer import SampleBuffer

NO_ROW = -1
_NO_OWNER = -1
# A block whose largest Σwd'² falls below this share of its peak: what single precision (6e-8) has lost at the
# peak is up to 1e-3 of what is left.
_PRECISE_SHARE = 1e-4
# Rounding of a variance up to which a block is left alone, in units of sigma_switch²: 0.7 % of an affinity.
_TOLERATED_ROUNDING = 0.01
# The mean of d' grows back after another shift, in some pairs at once. A block that has been recomputed for
# it waits until the mean square has grown by this factor over what it was right afterwards; that value decays
# by the second number at each update, so that the wait ends after 138 updates in any case.
_GROWTH, _DECAY = 4.0, 0.99


class RowIndex:
    """Rows of slots, handed out by strips that each belong to one source.

    What is observed at an instant then lies in few strips, and most blocks have nothing to do.

    Attributes
    ----------
    of
        intp [slots]: row of a slot, :data:`NO_ROW` for none.
    strips
        Number of strips.
    """

    def __init__(self) -> None:
        self.of: Slots = np.zeros(0, np.intp)
        self.strips = 0
        self._free: dict[int, list[int]] = {}
        self._owner: list[int] = []
        self._occupied: list[int] = []

    def fit(self, slots: int) -> None:
        """Make room for slots below a number."""
        self.of = np.pad(self.of, (0, slots - len(self.of)), constant_values=NO_ROW)

    def assign(self, slots: Slots, sources: Slots) -> None:
        """Give rows to those of n slots that have none; `sources` intp [n] are their sources."""
        without = self.of[slots] == NO_ROW
        for slot, source in zip(slots[without].tolist(), sources[without].tolist(), strict=True):
            free = self._free.setdefault(source, [])
            if not free:
                self._open_strip(source, free)
            self.of[slot] = row = free.pop()
            self._occupied[row // STRIP] += 1

    def release(self, slots: Slots) -> None:
        """Take the rows of slots back."""
        for slot in slots[self.of[slots] != NO_ROW].tolist():
            strip = int(self.of[slot]) // STRIP
            owner = self._owner[strip]
            self._free[owner].append(int(self.of[slot]))
            self.of[slot] = NO_ROW
            self._occupied[strip] -= 1
            if not self._occupied[strip]:
                # The source may never come back: any source may have an empty strip.
                self._free[owner] = [row for row in self._free[owner] if row // STRIP != strip]
                self._owner[strip] = _NO_OWNER

    def _open_strip(self, source: int, free: list[int]) -> None:
        if _NO_OWNER in self._owner:
            strip = self._owner.index(_NO_OWNER)
        else:
            strip = self.strips
            self.strips += 1
            self._owner.append(_NO_OWNER)
            self._occupied.append(0)
        self._owner[strip] = source
        free.extend(range(strip * STRIP + STRIP - 1, strip * STRIP - 1, -1))


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
        """Make room for so many strips."""
        if strips <= self.strips:
            return
        self.strips = strips
        if self.blocks > len(self.sums):
            # A quarter more at once: growing copies everything.
            room = int(_triangle(strips + strips // 8))
            grown = aligned_zeros((room, *self.sums.shape[1:]), self.dtype)
            grown[: len(self.sums)] = self.sums
            self.sums = grown
            extra = room - len(self._peak)
            self._peak, self._settled = np.pad(self._peak, (0, extra)), np.pad(self._settled, (0, extra))

    def add(self, samples: SampleBuffer) -> None:
        """Take samples into all blocks."""
        self._update_all(samples, 0.0, np.zeros((0, 0), np.float32))

    def add_and_compare(self, samples: SampleBuffer, sigma_switch: float, out: NDArray[np.float32]) -> Slots:
        """Take samples into all blocks and write the affinities (3.4) of all pairs.

        Parameters
        ----------
        samples
            What to take in.
        sigma_switch
            Standard deviation at which the affinity is 0.5.
        out
            float32 [rows, rows], written at and below the diagonal: 0.5 for pairs with fewer than two
            samples.

        Returns
        -------
        NDArray[intp]
            Blocks that have lost too many digits and should be recomputed.
        """
        rate = -1.0 / sigma_switch**2
        largest, reach = self._update_all(samples, rate, out)
        peak, settled = self._peak[: self.blocks], self._settled[: self.blocks]
        imprecise = largest < _PRECISE_SHARE * peak
        if self.blocks:
            # Far from the shift, squares cancel. Recomputed sums have another shift, one block at a time.
            settled *= _DECAY
            worst = int(reach.argmax())
            limit = _TOLERATED_ROUNDING / (-rate * np.finfo(self.dtype).eps)
            imprecise[worst] |= reach[worst] > max(limit, _GROWTH * settled[worst])
        return np.flatnonzero(imprecise)

    def compare(self, blocks: Slots, sigma_switch: float, out: NDArray[np.float32]) -> None:
        """Write the affinities of some blocks again, after they have been recomputed."""
        nothing = SampleBuffer(self.strips, self.dtype, room=0)
        where = blocks, *_strips_of(blocks)
        _, self._settled[blocks] = self._update(where, nothing, -1.0 / sigma_switch**2, out)

    def _update_all(
        self, samples: SampleBuffer, rate: float, out: NDArray[np.float32]
    ) -> tuple[Floats, Floats]:
        blocks = np.arange(self.blocks)
        largest, reach = self._update((blocks, *_strips_of(blocks)), samples, rate, out)
        peak = self._peak[: self.blocks]
        np.maximum(peak, largest, out=peak)
        return largest, reach

    def _update(
        self,
        where: tuple[Slots, Slots, Slots],
        samples: SampleBuffer,
        rate: float,
        out: NDArray[np.float32],
    ) -> tuple[Floats, Floats]:
        arrays = samples.values, samples.status, samples.any_partner
        shared = worth_waking(len(where[0]) * STRIP**2)
        largest, reach = update_blocks(
            self.sums, *where, *arrays, samples.count, self.dtype.type(rate), out, shared
        )
        return largest, reach

    def empty(self, block: int) -> tuple[int, int]:
        """Empty a block, for :meth:`add_to` to fill; returns the strips of its rows and its columns."""
        self.sums[block] = 0
        self._peak[block] = 0
        row, column = _strips_of(np.array([block]))
        return int(row[0]), int(column[0])

    def add_to(self, block: int, samples: SampleBuffer) -> None:
        """Take samples into one block, whose rows are their first strip and whose columns their last."""
        where = np.array([block]), np.zeros(1, np.intp), np.array([samples.strips - 1])
        largest, _ = self._update(where, samples, 0.0, np.zeros((0, 0), np.float32))
        self._peak[block] = max(self._peak[block], largest[0])

    def forget(self, rows: Slots) -> None:
        """Drop all samples of some rows."""
        for row in rows.tolist():
            strip, inside = divmod(row, STRIP)
            first = _triangle(strip)
            self.sums[first : first + strip + 1, 1:, inside, :] = 0
            below = np.arange(strip, self.strips)
            self.sums[_triangle(below) + strip, 1:, :, inside] = 0


def _triangle(strips: Any) -> Any:
    return strips * (strips + 1) // 2


def _strips_of(blocks: Slots) -> tuple[Slots, Slots]:
    """Strips of the rows and of the columns of blocks."""
    row = ((np.sqrt(8 * blocks + 1) - 1) // 2).astype(np.intp)
    return row, blocks - _triangle(row)
