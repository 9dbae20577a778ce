"""From an affinity matrix to clusters: the thesis's choice and the alternatives it compares."""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Floats32, Slots
from ..config import Clustering
from .halving import DivisiveKMeans
from .kernels import INCOMPARABLE

Labels = NDArray[np.intp]


Clusters = tuple[Labels, Floats]
"""Labels of n trajectories, intp [n], 0, 1, 2... in the order in which clusters first appear; and the mean
affinity of each to the other members of its cluster, float64 [n], 0.5 for a cluster of one."""
ClusterFunction = Callable[[Floats32, Slots], Clusters]
"""Affinities [m, m], symmetric, and the row of each trajectory, intp [n], known by it from call to call."""


def make_clustering(name: Clustering, stop_affinity: float) -> ClusterFunction:
    """Clustering by its name in the configuration.

    It may remember its last answer as a first guess of the next.
    """
    if name == "divisive-kmeans":
        divide = DivisiveKMeans(stop_affinity)
        return lambda affinity, rows: _named(*divide(affinity, rows))
    # They import scikit-learn, which takes half a second and the default does not need.
    from .alternatives import best_mixture, cut_spectrum  # noqa: PLC0415

    alternatives: dict[Clustering, Callable[[Floats], Labels]] = {
        "gmm-bic": best_mixture,
        "eigengap": partial(cut_spectrum, normalized=False),
        "eigengap-normalized": partial(cut_spectrum, normalized=True),
    }
    choice = alternatives[name]

    def cluster(affinity: Floats32, rows: Slots) -> Clusters:
        dense = affinity[np.ix_(rows, rows)].astype(np.float64)
        labels = choice(dense)
        return _named(labels, np.where(labels[:, None] == labels, dense, 0.0).sum(axis=1))

    return cluster


def _named(labels: Labels, sums: Floats) -> Clusters:
    """By the sum of the affinities of each trajectory to all members of its cluster, itself included."""
    companions = np.bincount(labels)[labels] - 1 if len(labels) else labels
    cohesion = np.where(companions > 0, (sums - 1) / np.maximum(companions, 1), INCOMPARABLE)
    return by_appearance(labels), cohesion


def by_appearance(labels: Labels) -> Labels:
    """Rename labels to 0, 1, 2... in the order in which they first appear."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]
