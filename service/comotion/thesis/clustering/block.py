"""A part of an affinity matrix, gathered into one triangle, and products with it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...aligned import aligned_zeros
from ...arrays import Bools, Floats, Slots
from ...compiled import compiled, numba_range, worth_waking
from ..affinity import Matrix

# Each has an array of its own to add up in; the same however many threads there are.
_CHUNKS = 8


@dataclass(frozen=True)
class Survey:
    """What one pass over a block tells.

    Attributes
    ----------
    sums
        float64 [n], of its rows.
    part
        float64 [n], of those columns in each row that were asked for.
    least
        The smallest element off the diagonal; 1 where there is none.
    """

    sums: Floats
    part: Floats
    least: float


@dataclass(frozen=True)
class Block:
    """Rows and columns below `size` of a matrix, at and below its diagonal."""

    matrix: Matrix
    size: int

    @classmethod
    def gathered(cls, matrix: Matrix, members: Slots, room: Matrix, some: Bools) -> tuple[Self, Survey]:
        """Copy some rows and columns of a matrix out, and look at them on the way.

        Parameters
        ----------
        matrix
            float32, symmetric; what is above its diagonal is not read.
        members
            intp [n], ascending: which rows and columns.
        room
            float32 [n, n] or larger, that is overwritten. Not used where the members are the first n
            rows anyway.
        some
            bool [n]: members of which the sums are wanted as well.
        """
        n = len(members)
        in_place = bool(members[-1] == n - 1)
        together = worth_waking(n * n // 2)
        sums, part, least = _gather(matrix, members, in_place, room, some, together)
        return cls(matrix if in_place else room, n), Survey(sums, part, float(least))

    def __len__(self) -> int:
        return self.size

    def times(self, vector: Floats | Bools) -> Floats:
        """Product with a vector, float64 [n]."""
        return _multiply(self.matrix, vector.astype(np.float32), worth_waking(self.size**2 // 2))

    def row(self, index: int) -> Floats:
        """Affinities of one member, float64 [n]."""
        left, below = self.matrix[index, : index + 1], self.matrix[index + 1 : self.size, index]
        return np.concatenate([left, below]).astype(np.float64)

    def rows(self) -> Floats:
        """Affinities of all, float64 [n, n]."""
        lower = np.tril(self.matrix[: self.size, : self.size]).astype(np.float64)
        return lower + np.tril(lower, -1).T


def room_for(size: int) -> Matrix:
    """Where a block of some size goes, and one that is a little larger."""
    return aligned_zeros((size + size // 8, size + size // 8), np.float32)


@compiled()
def _bounds(size: int, chunks: int) -> Slots:
    """Which rows belong to which chunk: rows are the longer the later."""
    bounds = np.empty(chunks + 1, np.intp)
    for k in range(chunks + 1):
        bounds[k] = round(size * np.sqrt(k / chunks))
    return bounds


@compiled(parallel=True, fastmath={"reassoc", "contract", "nsz", "nnan"})
def _gather(
    matrix: Matrix,
    members: Slots,
    in_place: bool,
    room: Matrix,
    some: Bools,
    together: bool,
) -> tuple[Floats, Floats, float]:
    n, chunks = len(members), _CHUNKS if together else 1
    bounds = _bounds(n, chunks)
    weight = some.astype(np.float32)
    # Unsigned, or each would be asked whether it counts from the end.
    columns = members.astype(np.uint32)
    sums, part = np.zeros((chunks, n), np.float32), np.zeros((chunks, n), np.float32)
    # A minimum per column: of one alone the compiler makes no vector instructions.
    least = np.ones((chunks, n), np.float32)
    if together:
        for k in numba_range(chunks):
            span = bounds[k], bounds[k + 1]
            _survey(matrix, columns, in_place, room, weight, span, sums[k], part[k], least[k])
    else:
        _survey(matrix, columns, in_place, room, weight, (0, n), sums[0], part[0], least[0])
    return _total(sums), _total(part), least.min()


@compiled(fastmath={"reassoc", "contract", "nsz", "nnan"})
def _survey(
    matrix: Matrix,
    members: NDArray[np.uint32],
    in_place: bool,
    room: Matrix,
    weight: Matrix,
    span: tuple[int, int],
    sums: Matrix,
    part: Matrix,
    least: Matrix,
) -> None:
    for r in range(span[0], span[1]):
        here = matrix[members[r]]
        if not in_place:
            for c in range(r + 1):
                room[r, c] = here[members[c]]
        row = here[: r + 1] if in_place else room[r, : r + 1]
        x, found, some = weight[r], row[r], row[r] * weight[r]
        for c in range(r):
            a = row[c]
            found += a
            some += a * weight[c]
            sums[c] += a
            part[c] += a * x
            least[c] = min(least[c], a)
        sums[r] += found
        part[r] += some


@compiled(parallel=True, fastmath={"reassoc", "contract", "nsz", "nnan"})
def _multiply(matrix: Matrix, vector: Matrix, together: bool) -> Floats:
    """Add up the product of a symmetric matrix and a vector from one triangle, chunk by chunk."""
    n, chunks = len(vector), _CHUNKS if together else 1
    bounds = _bounds(n, chunks)
    total = np.zeros((chunks, n), np.float32)
    if together:
        for k in numba_range(chunks):
            _multiply_rows(matrix, vector, bounds[k], bounds[k + 1], total[k])
    else:
        _multiply_rows(matrix, vector, 0, n, total[0])
    return _total(total)


@compiled(fastmath={"reassoc", "contract", "nsz", "nnan"})
def _multiply_rows(matrix: Matrix, vector: Matrix, first: int, last: int, total: Matrix) -> None:
    for r in range(first, last):
        row, x = matrix[r, :r], vector[r]
        found = matrix[r, r] * x
        for c in range(r):
            a = row[c]
            found += a * vector[c]
            total[c] += a * x
        total[r] += found


@compiled()
def _total(parts: Matrix) -> Floats:
    total = np.zeros(parts.shape[1])
    for part in parts:
        for c in range(len(total)):
            total[c] += part[c]
    return total
