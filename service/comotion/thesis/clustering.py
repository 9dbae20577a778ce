"""From an affinity matrix to clusters: the thesis's choice and the alternatives it compares.

Divisive k-means (3.6): halve the affinity graph while a cluster holds a weak edge.

A cluster is split by 2-means on its rows of the affinity matrix. The edges between the halves are cut,
so that from there on each half sees its own columns alone.

Both steps of 2-means are products with the matrix A of the cluster: with the indicator h of one half,
A·h gives the means of both halves, and A·(difference of the means) says which is nearer.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Floats32, Ints, Slots
from ..config import Clustering
from .kernels import INCOMPARABLE, combine_rows, holds_weak_edge

Clusters = tuple[Ints, Floats]
"""Labels of n trajectories, intp [n], 0, 1, 2... in the order in which clusters first appear; and the mean
affinity of each to the other members of its cluster, float64 [n], 0.5 for a cluster of one."""
ClusterFunction = Callable[[Floats32, Slots], Clusters]
"""Affinities [m, m], symmetric, and the row of each trajectory, intp [n], known by it from call to call."""
Product = Callable[[NDArray[Any]], Floats]
"""Of the affinities of a cluster, [n, n], and a column, [n]."""
# 2-means always ends, since no step makes the scatter larger; this bounds what one update may cost.
_MAX_STEPS = 100
# A split of n members has settled when fewer than n / 64 change sides: the means would hardly move.
_SETTLED_SHARE = 64
# Steps of power iteration towards the principal component. On sixteen scenes and eight recordings (seed 0)
# the mean NMI from its sides is .8592, that from the best of 24 starts .8590.
_POWERS = 4


def make_clustering(name: Clustering, stop_affinity: float) -> ClusterFunction:
    """Clustering by its name in the configuration.

    It may remember its last answer as a first guess of the next.
    """
    if name == "divisive-kmeans":
        return DivisiveKMeans(stop_affinity)
    # They import scikit-learn, which takes half a second and the default does not need.
    from .alternatives import best_mixture, cut_spectrum  # noqa: PLC0415

    alternatives: dict[Clustering, Callable[[Floats], Ints]] = {
        "gmm-bic": best_mixture,
        "eigengap": partial(cut_spectrum, normalized=False),
        "eigengap-normalized": partial(cut_spectrum, normalized=True),
    }
    choice = alternatives[name]

    def cluster(affinity: Floats32, rows: Slots) -> Clusters:
        dense = affinity[np.ix_(rows, rows)].astype(np.float64)
        labels = choice(dense) if len(rows) > 1 else np.zeros(len(rows), np.intp)
        return _named(labels, np.where(labels[:, None] == labels, dense, 0.0).sum(axis=1))

    return cluster


def _named(labels: Ints, sums: Floats) -> Clusters:
    """By the sum of the affinities of each trajectory to all members of its cluster, itself included."""
    companions = np.bincount(labels)[labels] - 1 if len(labels) else labels
    cohesion = np.where(companions > 0, (sums - 1) / np.maximum(companions, 1), INCOMPARABLE)
    return by_appearance(labels), cohesion


def by_appearance(labels: Ints) -> Ints:
    """Rename labels to 0, 1, 2... in the order in which they first appear."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


class DivisiveKMeans:
    """Clusters whose smallest affinity is above `stop_affinity`.

    The splits of one call are the first guess of the next: of a large cluster, two products with the matrix
    confirm that nothing moves.
    """

    def __init__(self, stop_affinity: float) -> None:
        # As the affinities are: in single precision.
        self._stop_affinity = float(np.float32(stop_affinity))
        # By depth, int8 [rows]: the side that each took at the split of the last call, 1 or -1; 0 for none.
        self._sides: list[NDArray[np.int8]] = []

    def __call__(self, affinity: Floats32, rows: Slots) -> Clusters:
        """Split trajectories into clusters, as a :data:`ClusterFunction`."""
        labels, inside, all_rows = np.zeros(len(affinity), np.intp), np.zeros(len(affinity)), np.sort(rows)
        # Members of a cluster, the sum of affinities of each inside it, and how often it was split off.
        sums = _times(affinity, all_rows, np.ones(len(rows)))
        pending = [(all_rows, sums, 0)] if len(rows) else []
        last_sides, self._sides = self._sides, []
        count = 0
        while pending:
            members, sums, depth = pending.pop()
            if not holds_weak_edge(affinity, members, self._stop_affinity):
                labels[members], inside[members] = count, sums
                count += 1
                continue
            guess = np.zeros(len(affinity), np.int8)
            if depth < len(last_sides):
                guess[: len(last_sides[depth])] = last_sides[depth][: len(guess)]
            second, to_second = _halved(affinity, members, sums, guess[members])
            if 2 * np.count_nonzero(second) > len(members):
                # The next guess costs less with the indicator of the smaller half.
                second, to_second = ~second, sums - to_second
            if depth == len(self._sides):
                self._sides.append(np.zeros(len(affinity), np.int8))
            self._sides[depth][members] = np.where(second, 1, -1)
            pending.append((members[second], to_second[second], depth + 1))
            pending.append((members[~second], (sums - to_second)[~second], depth + 1))
        return _named(labels[rows], inside[rows])


def _times(affinity: Floats32, rows: Ints, factors: NDArray[Any]) -> Floats:
    """Product of some rows and columns with factors, [m]; rows times 0 are not read."""
    out, nonzero = np.zeros(len(affinity)), np.flatnonzero(factors)
    combine_rows(affinity, rows[nonzero], factors[nonzero].astype(np.float64), out)
    return out[rows]


def _halved(affinity: Floats32, members: Ints, sums: Floats, guess: NDArray[np.int8]) -> tuple[Bools, Floats]:
    """Split m members by 2-means, from a guess, else from the sides of their principal component.

    That is where the continuous problem has its best split (Ding and He 2004). Returns the second half, bool
    [m], and the sums of the affinities to it, float64 [m].
    """
    if (guess > 0).any() and (guess < 0).any():
        return _two_means(partial(_times, affinity, members), sums, guess > 0)
    rows = affinity.take(members, 0).take(members, 1)
    product = partial(_times, rows, np.arange(len(members)))
    mean = sums / len(members)
    direction = rows[sums.argmin()] - mean
    for _ in range(_POWERS):
        along = product(direction) - mean @ direction
        direction = product(along) - mean * along.sum()
    return _two_means(product, sums, along > 0)


def _two_means(product: Product, sums: Floats, second: Bools) -> tuple[Bools, Floats]:
    """2-means (3.6) from a first guess at one half, bool [n], which is not empty nor all.

    `product` and `sums` float64 [n] are of the affinities of n members.
    """
    n = len(sums)
    for _ in range(_MAX_STEPS):
        count, to_second = np.count_nonzero(second), product(second)
        mean, other_mean = (sums - to_second) / (n - count), to_second / count
        closer = product(other_mean - mean) > (other_mean @ other_mean - mean @ mean) / 2
        if closer.all() or not closer.any():
            return second, to_second
        previous, second = second, closer
        if np.count_nonzero(second != previous) <= n // _SETTLED_SHARE:
            break
    return second, to_second + product(second.astype(np.float64) - previous)
