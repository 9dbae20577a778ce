"""Some rows and columns of an affinity matrix, gathered into one triangle, and products with it."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from ...arrays import Bools, Floats, Slots, aligned_zeros
from ...compiled import worth_waking
from ..affinity import Matrix
from ..kernels.halving import gather, multiply


@dataclass(frozen=True)
class Totals:
    """What one pass over a submatrix gives.

    Attributes
    ----------
    sums
        float64 [n], of its rows.
    part
        float64 [n], of its rows over some of the columns.
    least
        The smallest element off the diagonal; 1 where there is none.
    """

    sums: Floats
    part: Floats
    least: float


@dataclass(frozen=True)
class Submatrix:
    """Rows and columns below `size` of a matrix, at and below its diagonal."""

    matrix: Matrix
    size: int

    @classmethod
    def gathered(cls, matrix: Matrix, members: Slots, room: Matrix, some: Bools) -> tuple[Self, Totals]:
        """Copy some rows and columns of a matrix out, and sum them up on the way.

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
            bool [n]: columns of :attr:`Totals.part`.
        """
        n = len(members)
        in_place = bool(members[-1] == n - 1)
        sums, part, least = gather(matrix, members, in_place, room, some, worth_waking(n * n // 2))
        return cls(matrix if in_place else room, n), Totals(sums, part, float(least))

    def __len__(self) -> int:
        return self.size

    def times(self, vector: Floats | Bools) -> Floats:
        """Product with a vector [n], in single precision: float64 [n]."""
        product: Floats = multiply(self.matrix, vector.astype(np.float32), worth_waking(self.size**2 // 2))
        return product

    def row(self, index: int) -> Floats:
        """Affinities of one member, float64 [n]."""
        left, below = self.matrix[index, : index + 1], self.matrix[index + 1 : self.size, index]
        return np.concatenate([left, below]).astype(np.float64)

    def rows(self) -> Floats:
        """Affinities of all, float64 [n, n]."""
        lower = np.tril(self.matrix[: self.size, : self.size]).astype(np.float64)
        return lower + np.tril(lower, -1).T


def room_for(size: int) -> Matrix:
    """Room for a submatrix of some size, or one that is a little larger."""
    return aligned_zeros((size + size // 8, size + size // 8), np.float32)
