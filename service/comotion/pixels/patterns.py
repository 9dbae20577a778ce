"""Rows of ones and zeros that are alike: what follows from them is computed once."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .sampling import Indices


class Patterns(NamedTuple):
    """P different rows among M.

    Attributes
    ----------
    first
        intp [P]; the first row of each pattern.
    of
        intp [M]; the pattern of every row.
    """

    first: Indices
    of: Indices


def alike(rows: NDArray[Any]) -> Patterns:
    """Patterns of M rows of ones and zeros, [M, Q]."""
    bits = np.packbits(rows > 0, axis=1)
    # A byte that all have in common: without columns there is still one pattern.
    keys = np.zeros((len(bits), bits.shape[1] + 1), np.uint8)
    keys[:, 1:] = bits
    _, first, of = np.unique(keys.view(f"V{keys.shape[1]}")[:, 0], return_index=True, return_inverse=True)
    return Patterns(first, of)
