"""A part of an affinity matrix that is kept in one triangle, and products with it."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from ..affinity import Affinity, Matrix
from ..compiled import compiled, numba_range, threads_for
from ..window import Bools, Floats, Slots

# Each has an array of its own to add up in; the same however many threads there are.
_CHUNKS = 8
# A part is copied out when it has left so much of the rows and columns around it.
_SPARSE = 0.85


@dataclass(frozen=True)
class Block:
    """Rows and columns `members` (intp [n], ascending) of a matrix, below its diagonal."""

    matrix: Matrix
    members: Slots

    @classmethod
    def of(cls, affinity: Affinity) -> tuple[Self, Slots]:
        """All of it; and which trajectory each member is, intp [n]."""
        order = np.argsort(affinity.places)
        return cls(affinity.matrix, affinity.places[order]), order

    def __len__(self) -> int:
        return len(self.members)

    def is_sparse(self, count: int) -> bool:
        """Whether so many members are few of the rows and columns they lie among."""
        return count <= _SPARSE * (int(self.members[-1]) + 1)

    def part(self, chosen: Slots, room: Matrix) -> Self:
        """Some of the members, by ascending index; `room` is where a copy may go."""
        members = self.members[chosen]
        if not self.is_sparse(len(members)):
            return type(self)(self.matrix, members)
        with threads_for(len(members) ** 2 // 2):
            _copy(self.matrix, members, room)
        # All of the room, for a view of a part would not be contiguous, and much slower to go through.
        return type(self)(room, np.arange(len(members)))

    def times(self, vector: Floats | Bools) -> tuple[Floats, float]:
        """Product with a vector, float64 [n], and the smallest element off the diagonal."""
        starts, stops, bounds = self._layout
        values = vector.astype(np.float32)
        with threads_for(len(self) ** 2 // 8):
            product, least = _multiply(self.matrix, self.members, starts, stops, bounds, values)
        return product, float(least)

    @cached_property
    def _layout(self) -> tuple[Slots, Slots, Slots]:
        """Begins and ends of the runs of members, and which rows belong to which chunk."""
        ends = np.flatnonzero(np.diff(self.members) > 1)
        starts = self.members[np.append(0, ends + 1)]
        stops = self.members[np.append(ends, len(self) - 1)] + 1
        # Rows are the longer the later.
        bounds = np.round(len(self) * np.sqrt(np.arange(_CHUNKS + 1) / _CHUNKS)).astype(np.intp)
        return starts, stops, bounds

    def row(self, index: int) -> Floats:
        """Affinities of one member, float64 [n]."""
        here = self.members[index]
        before, after = self.members[: index + 1], self.members[index + 1 :]
        return np.concatenate([self.matrix[here, before], self.matrix[after, here]]).astype(np.float64)


@compiled(parallel=True, fastmath={"reassoc", "contract", "nsz", "nnan"})
def _multiply(
    matrix: Matrix, members: Slots, starts: Slots, stops: Slots, bounds: Slots, vector: Matrix
) -> tuple[Floats, float]:
    """Add up the product of a symmetric matrix and a vector from one triangle, chunk by chunk."""
    width = members[-1] + 1
    spread = np.zeros(width, np.float32)
    for r in range(len(members)):
        spread[members[r]] = vector[r]
    total = np.zeros((_CHUNKS, width), np.float32)
    # A minimum per column: of one alone the compiler makes no vector instructions.
    least = np.ones((_CHUNKS, width), np.float32)
    for chunk in numba_range(_CHUNKS):
        mine, low, run = total[chunk], least[chunk], 0
        for r in range(bounds[chunk], bounds[chunk + 1]):
            p = members[r]
            while stops[run] <= p:
                run += 1
            row, x, found = matrix[p], spread[p], spread[p]
            for k in range(run + 1):
                span = slice(starts[k], min(stops[k], p))
                found += _pass(row[span], spread[span], x, mine[span], low[span])
            mine[p] += found
    product = np.zeros(len(members))
    for chunk in range(_CHUNKS):
        for r in range(len(members)):
            product[r] += total[chunk, members[r]]
    return product, least.min()


@compiled(fastmath={"reassoc", "contract", "nsz", "nnan"})
def _pass(row: Matrix, vector: Matrix, x: np.float32, total: Matrix, least: Matrix) -> np.float32:
    found = np.float32(0)
    for q in range(len(row)):
        a = row[q]
        found += a * vector[q]
        total[q] += a * x
        least[q] = min(least[q], a)
    return found


@compiled(parallel=True)
def _copy(matrix: Matrix, members: Slots, out: Matrix) -> None:
    for r in numba_range(len(members)):
        row = matrix[members[r]]
        for c in range(r + 1):
            out[r, c] = row[members[c]]
