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
"""Of the affinities of a cluster, [n, n], and columns, [n, starts]."""
# 2-means always ends, since no step makes the scatter larger; this bounds what one update may cost.
_MAX_STEPS = 100
# A split of n members has settled when fewer than n / 64 change sides: the means would hardly move.
_SETTLED_SHARE = 64
# Starts of 2-means, and the number of members up to which all are made; fewer starts of more members take as
# long. On recordings, one split in five ended at a worse 2-means from two or three starts than from
# scikit-learn's ten random ones; from 24 starts, one in a hundred.
_STARTS, _MANY_STARTS_SIZE = 24, 128


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
        sums = _times(affinity, all_rows, np.ones((len(rows), 1)))[:, 0]
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


def _times(affinity: Floats32, members: Ints, factors: NDArray[Any]) -> Floats:
    """Product of the rows and columns of m members with factors, [m, 1]; rows times 0 are not read."""
    out, nonzero = np.zeros(len(affinity)), np.flatnonzero(factors)
    combine_rows(affinity, members[nonzero], factors[nonzero, 0].astype(np.float64), out)
    return out[members, None]


def _halved(affinity: Floats32, members: Ints, sums: Floats, guess: NDArray[np.int8]) -> tuple[Bools, Floats]:
    """Split m members by 2-means: by a step from a guess that fits a large cluster, else from several starts.

    Returns
    -------
    second, to_second
        bool [m], and float64 [m]: the sums of affinities to that half.
    """
    n, many = len(members), len(members) <= _MANY_STARTS_SIZE
    guessed = np.column_stack([guess < 0, guess > 0])
    if not many and guessed.any(0).all() and np.count_nonzero(guess == 0) <= n // _SETTLED_SHARE:
        # Rows times 0 are not read, and none is copied.
        product = partial(_times, affinity, members)
        second, to_second, is_settled = _two_means(product, sums, guessed[:, 1:], 1)
        if is_settled:
            return second, to_second
    # Columns of rows: twice as fast as both at once.
    part = affinity.take(members, 0).take(members, 1)
    rows: Floats | Floats32 = part.astype(np.float64) if many else part

    def dense(of: NDArray[Any]) -> Floats:
        return np.asarray(rows @ of.astype(rows.dtype), np.float64)

    starts = _around_rows(rows, sums, _STARTS if many else max(_STARTS * _MANY_STARTS_SIZE // n, 2))
    if guessed.any(0).all():
        # Members without a guess go to the nearer half.
        halves = dense(guessed) / guessed.sum(0)
        nearer = dense(halves[:, 1:] - halves[:, :1]) > np.diff(np.square(halves).sum(0)) / 2
        starts = np.hstack([nearer, starts])
    return _two_means(dense, sums, starts[:, starts.any(0) & ~starts.all(0)])[:2]


def _around_rows(rows: Floats | Floats32, sums: Floats, count: int) -> Bools:
    """Halves around some rows and the one least like all, each against the one least like it, bool [n, m]."""
    first = np.unique([*np.linspace(0, len(rows) - 1, count).astype(np.intp), sums.argmin()])
    last = rows[first].argmin(1)
    middle = (np.square(rows[last]).sum(1) - np.square(rows[first]).sum(1)) / 2
    second = rows @ (rows[last] - rows[first]).T > middle
    second[last, np.arange(len(last))] = True
    second[first, np.arange(len(first))] = False
    return np.asarray(second, np.bool_)


def _two_means(
    product: Product, sums: Floats, second: Bools, steps: int = _MAX_STEPS
) -> tuple[Bools, Floats, bool]:
    """The best of 2-means (3.6) from some starts, in so many steps at most.

    Parameters
    ----------
    product, sums
        Of the affinities of n members, and the sums of their rows, float64 [n].
    second
        bool [n, starts], first guesses at one half, neither of them empty.

    Returns
    -------
    second, to_second, is_settled
        bool [n]; float64 [n], the sums of affinities to that half; whether no step more would change it.
    """
    n = len(second)
    settled = 0 if n <= _MANY_STARTS_SIZE else n // _SETTLED_SHARE
    for _ in range(steps):
        count, to_second = second.sum(0), product(second)
        mean, other_mean = (sums[:, None] - to_second) / (n - count), to_second / count
        lengths = np.square(mean).sum(0), np.square(other_mean).sum(0)
        # What (3.6) minimises, less the same constant for every split.
        scatter = -(n - count) * lengths[0] - count * lengths[1]
        closer = product(other_mean - mean) > (lengths[1] - lengths[0]) / 2
        closer = np.where(closer.all(0) | ~closer.any(0), second, closer)
        previous, second = second, closer
        is_settled = bool((second != previous).sum(0).max() <= settled)
        if is_settled:
            break
    best = int(scatter.argmin())
    moved = second[:, [best]].astype(np.float64) - previous[:, [best]]
    return second[:, best], (to_second[:, [best]] + product(moved))[:, 0], is_settled
