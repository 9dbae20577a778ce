"""Which body continues which hypothesis."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ..arrays import Ints
from ..partition import NO_HYPOTHESIS


def match(labels: Ints, before: NDArray[np.int64], bodies: int) -> dict[int, int]:
    """Hypothesis that each body continues, {column: id}: most shared trajectories in all.

    Parameters
    ----------
    labels
        intp [N], column of the body or -1.
    before
        int64 [N], hypothesis until now or :data:`NO_HYPOTHESIS`.
    """
    known = np.setdiff1d(before, NO_HYPOTHESIS)
    both = (labels >= 0) & (before != NO_HYPOTHESIS)
    shared = np.zeros((len(known), bodies), np.int64)
    np.add.at(shared, (np.searchsorted(known, before[both]), labels[both]), 1)
    rows, columns = linear_sum_assignment(-shared)
    return {
        int(c): int(known[r])
        for r, c in zip(rows.tolist(), columns.tolist(), strict=True)
        if shared[r, c] > 0
    }


def columns_before(before: NDArray[np.int64], matched: dict[int, int]) -> Ints:
    """Column of the body that continues each trajectory's hypothesis, or -1, intp [N]."""
    found = np.full(len(before), -1, np.intp)
    for k, hypothesis in matched.items():
        found[before == hypothesis] = k
    return found
