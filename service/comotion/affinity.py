"""Affinity of trajectories from the variance of their distance (3.4)."""

import math

import numpy as np
from numpy.typing import NDArray

from .window import Bools, Floats

INCOMPARABLE = 0.5
"""Affinity of a pair with fewer than two common samples: neither high nor low."""


def affinity_matrix(variance: Floats, comparable: Bools, sigma_switch: float) -> Floats:
    """Affinity (3.4), exp(−γσ²) with γ = −ln 0.5 / sigma_switch²: float64 [n, n], 1 on the diagonal.

    Parameters
    ----------
    variance
        float64 [n, n], σ² of (3.3).
    comparable
        bool [n, n]; other pairs get :data:`INCOMPARABLE`.
    sigma_switch
        Standard deviation at which the affinity is 0.5, in the unit of the distances.
    """
    affinity = np.where(comparable, np.exp(math.log(0.5) / sigma_switch**2 * variance), INCOMPARABLE)
    np.fill_diagonal(affinity, 1.0)
    return affinity


def mean_to_members(affinity: Floats, labels: NDArray[np.int64]) -> Floats:
    """Mean affinity of each trajectory to the other members of its cluster, float64 [n].

    A trajectory that is alone gets :data:`INCOMPARABLE`: there is nothing to tell by.
    """
    same = labels[:, None] == labels
    others = same.sum(axis=1) - 1
    total = np.where(same, affinity, 0.0).sum(axis=1) - affinity.diagonal()
    return np.where(others > 0, total / np.maximum(others, 1), INCOMPARABLE)
