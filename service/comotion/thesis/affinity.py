"""Affinities (3.4) of trajectories as methods and clusterings share them."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Slots

INCOMPARABLE = 0.5
"""Affinity of a pair with fewer than two common samples: neither high nor low."""

Matrix = NDArray[np.float32]


@dataclass(frozen=True)
class Affinity:
    """Affinities of n trajectories, where they were computed.

    Attributes
    ----------
    matrix
        float32 [P, P]: that of two trajectories at [larger row, smaller row], 1 on the diagonal; what is
        above the diagonal means nothing.
    rows
        intp [n]: row of each trajectory.
    """

    matrix: Matrix
    rows: Slots

    @classmethod
    def of(cls, dense: Floats | Matrix) -> Self:
        """That of a symmetric matrix [n, n]."""
        return cls(np.asarray(dense, np.float32), np.arange(len(dense)))

    def __len__(self) -> int:
        return len(self.rows)

    def dense(self) -> Matrix:
        """float32 [n, n], symmetric, a copy."""
        high = np.maximum.outer(self.rows, self.rows)
        return self.matrix[high, np.minimum.outer(self.rows, self.rows)]
