"""Divisive k-means (3.6): halve the affinity graph while a cluster holds a weak edge.

A cluster is split by 2-means on its rows of the affinity matrix. The edges between the halves are cut,
so that from there on each half sees its own columns alone.

Both steps of 2-means are products with the matrix A of the cluster: with the indicator h of one half,
g = A·h gives the means of both halves, and A·(difference of the means) says which is nearer. That
difference is a multiple of A·(h less its mean), so that a step of 2-means is a step of the power
iteration towards the direction in which the rows vary most, but for the rounding to halves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Floats32, Slots
from ..compiled import worth_waking
from .kernels import gather

# 2-means always ends, since no step makes the scatter larger; this bounds what one update may cost.
_MOST_STEPS = 100
# Power iteration stops earlier where a step no longer changes the cut.
_POWER_STEPS = 10
# 2-means of one-dimensional scores settles after so many steps, but for a few scores about the threshold.
_THRESHOLD_STEPS = 3
# A split of n members has settled when fewer than n / 64 change sides: the means would hardly move.
_SETTLED_SHARE = 64
# Up to so many members, many starts are tried at once. On recordings, one split in five ended at a worse
# 2-means from two or three starts than from scikit-learn's ten random ones; from 24 starts, one in a hundred.
_MANY_STARTS_SIZE = 128
_STARTS = 24
# Rows per part in which a weak edge is looked for: most clusters that have one have one in the first.
_ROWS_AT_ONCE = 64


@dataclass(frozen=True)
class _Halves:
    second: Bools
    # What (3.6) minimises, less the same constant for every split.
    scatter: float
    # Product of each row with the difference of the means: the larger, the nearer to the second.
    score: Floats


@dataclass(frozen=True)
class _Cluster:
    """Rows and columns of the affinity matrix.

    Attributes
    ----------
    affinity
        float32 [n, n], of the members.
    members
        intp [n]: which rows they are.
    unchanged
        bool [n]: those that all splits so far have put where the last call did.
    depth
        Number of splits so far.
    """

    affinity: Floats32
    members: Slots
    unchanged: Bools
    depth: int


class DivisiveKMeans:
    """Clusters whose smallest affinity is above `stop_affinity`.

    The splits of one call are the first guess of the next: of a large cluster, four products with the
    matrix confirm that it still is a best split, and that the leading direction gives the same.
    """

    def __init__(self, stop_affinity: float) -> None:
        # As the affinities are: in single precision.
        self._stop_affinity = float(np.float32(stop_affinity))
        # Of each slot: the sides that it took at the splits of the last call, bool [depths, slots], and how
        # many splits there were.
        self._sides: Bools = np.zeros((0, 0), np.bool_)
        self._splits: Slots = np.zeros(0, np.intp)

    def __call__(self, affinity: Floats32, slots: Slots) -> tuple[NDArray[np.intp], Floats]:
        """Split trajectories into clusters.

        Parameters
        ----------
        affinity
            float32 [n, n], symmetric.
        slots
            intp [n]: by what a trajectory is known from call to call.

        Returns
        -------
        labels, inside
            intp [n], and float64 [n]: the sum of affinities of each inside its cluster.
        """
        n = len(slots)
        labels, inside = np.zeros(n, np.intp), np.zeros(n)
        pending = [_Cluster(affinity, np.arange(n), np.ones(n, np.bool_), 0)] if n else []
        found = 0
        while pending:
            cluster = pending.pop()
            sums = cluster.affinity.sum(axis=1)
            halves = self._split(cluster, slots[cluster.members], sums)
            pending += halves
            if not halves:
                labels[cluster.members], inside[cluster.members] = found, sums
                found += 1
        return labels, inside

    def _split(self, cluster: _Cluster, slots: Slots, sums: Floats) -> list[_Cluster]:
        """The halves of a cluster, none where it holds no weak edge."""
        affinity, depth = cluster.affinity, cluster.depth
        self._fit(depth + 1, int(slots.max()) + 1)
        if not self._holds_weak_edge(affinity):
            self._splits[slots] = depth
            return []
        side, unchanged = self._sides[depth, slots], cluster.unchanged & (self._splits[slots] > depth)
        second = halve(affinity, sums, side & unchanged)
        self._sides[depth, slots] = second
        unchanged &= side == second
        return [
            _Cluster(_part(affinity, part), cluster.members[part], unchanged[part], depth + 1)
            for part in (np.flatnonzero(second), np.flatnonzero(~second))
        ]

    def _holds_weak_edge(self, affinity: Floats32) -> bool:
        parts = (affinity[k : k + _ROWS_AT_ONCE] for k in range(0, len(affinity), _ROWS_AT_ONCE))
        return len(affinity) > 1 and any(part.min() <= self._stop_affinity for part in parts)

    def _fit(self, depths: int, slots: int) -> None:
        more, wider = max(depths - len(self._sides), 0), max(slots - len(self._splits), 0)
        if more or wider:
            self._sides = np.pad(self._sides, ((0, more), (0, wider)))
            self._splits = np.pad(self._splits, (0, wider))


def halve(affinity: Floats32, sums: Floats, guess: Bools) -> Bools:
    """2-means (3.6) on the rows of a matrix, not all equal; bool [n], neither half empty.

    Parameters
    ----------
    affinity
        float32 [n, n], symmetric, n of 2 or more.
    sums
        float [n], of its rows.
    guess
        bool [n]: a first guess at one half; all alike for none.
    """
    n = len(affinity)
    if n == 2:
        return np.array([False, True])
    if n <= _MANY_STARTS_SIZE:
        rows = affinity.astype(np.float64)
        starts = np.column_stack([guess, _least_alike(affinity, sums), _around_rows(rows)])
        return _two_means(rows, sums, starts[:, starts.any(0) & ~starts.all(0)], 0).second
    settled, tried = n // _SETTLED_SHARE, []
    if guess.any() and not guess.all():
        tried = [_two_means(affinity, sums, guess[:, None], settled)]
        if _apart(_leading_cut(affinity, tried[0].score, 1), tried[0].second) <= settled:
            return tried[0].second
    tried.append(_two_means(affinity, sums, _least_alike(affinity, sums)[:, None], settled))
    leading = _leading_cut(affinity, tried[-1].score, _POWER_STEPS)
    if all(_apart(leading, known.second) for known in tried):
        tried.append(_two_means(affinity, sums, leading[:, None], settled))
    return min(tried, key=lambda halves: halves.scatter).second


def _around_rows(rows: Floats) -> Bools:
    """Halves around some of the rows, each against the one least like it, bool [n, starts]."""
    first = np.unique(np.linspace(0, len(rows) - 1, _STARTS).astype(np.intp))
    last = rows[first].argmin(1)
    middle = (np.square(rows[last]).sum(1) - np.square(rows[first]).sum(1)) / 2
    second = rows @ (rows[last] - rows[first]).T > middle
    second[last, np.arange(len(last))] = True
    second[first, np.arange(len(first))] = False
    return np.asarray(second, np.bool_)


def _distinct(splits: Bools) -> Bools:
    """The columns that differ, each where it first is: most starts soon meet."""
    first: dict[bytes, int] = {}
    for k, split in enumerate(np.packbits(splits.T, axis=1)):
        first.setdefault(split.tobytes(), k)
    return splits[:, list(first.values())]


def _two_means(rows: Floats | Floats32, sums: Floats, second: Bools, settled: int) -> _Halves:
    """The best of 2-means from some starts.

    Parameters
    ----------
    rows, sums
        float [n, n] and [n].
    second
        bool [n, starts], first guesses at one half, neither of them empty.
    settled
        It ends when no start moves more rows to the nearer of its two means.
    """
    n = len(rows)
    for _ in range(_MOST_STEPS):
        second = _distinct(second)
        half, count = _product(rows, second), second.sum(0)
        mean, other = (sums[:, None] - half) / (n - count), half / count
        lengths = np.square(mean).sum(0), np.square(other).sum(0)
        scatter = -(n - count) * lengths[0] - count * lengths[1]
        score = _product(rows, other - mean)
        closer = score > (lengths[1] - lengths[0]) / 2
        closer = np.where(closer.all(0) | ~closer.any(0), second, closer)
        moved, second = (closer != second).sum(0), closer
        if moved.max() <= settled:
            break
    best = int(scatter.argmin())
    return _Halves(second[:, best], float(scatter[best]), score[:, best])


def _part(affinity: Floats32, members: Slots) -> Floats32:
    many = worth_waking(affinity.size)
    return gather(affinity, members) if many else affinity[np.ix_(members, members)]


def _product(rows: Floats | Floats32, other: Floats | Bools) -> Floats:
    """Of a matrix and a vector, or columns, in the precision of the matrix."""
    product: Floats = (rows @ other.astype(rows.dtype)).astype(np.float64)
    return product


def _least_alike(affinity: Floats32, sums: Floats) -> Bools:
    """Halves around the row that is least like all others, and the one least like it."""
    first = affinity[int(sums.argmin())].astype(np.float64)
    last = affinity[int(first.argmin())].astype(np.float64)
    score = _product(affinity, last - first)
    second: Bools = score > (last @ last - first @ first) / 2
    if second.all() or not second.any():
        second = first < first.max()
    return second


def _leading_cut(affinity: Floats32, score: Floats, steps: int) -> Bools:
    """Halves along the direction in which the rows vary most, by power iteration from a first guess."""
    halves = cut(score)
    for _ in range(steps):
        direction = _product(affinity, score - score.mean())
        score = _product(affinity, direction / max(np.abs(direction).max(), np.finfo(np.float64).tiny))
        before, halves = halves, cut(score)
        if not _apart(before, halves):
            break
    return halves


def cut(score: Floats) -> Bools:
    """Two halves of numbers [n] by 2-means; all but the least where that leaves one half empty."""
    second: Bools = score > score.min()
    threshold = score.mean()
    for _ in range(_THRESHOLD_STEPS):
        above = score > threshold
        count = np.count_nonzero(above)
        if not 0 < count < len(score):
            least: Bools = score > score.min()
            return least
        second, high = above, score @ above
        threshold = (high / count + (score.sum() - high) / (len(score) - count)) / 2
    return second


def _apart(one: Bools, other: Bools) -> int:
    """How many would have to change sides to make two splits the same."""
    differ = int((one != other).sum())
    return min(differ, len(one) - differ)
