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

from ...arrays import Bools, Floats, Slots
from ..affinity import Affinity, Matrix
from ..kernels.halving import cut, means, nearer
from .submatrix import Submatrix, Totals, room_for

# 2-means always ends, since no step makes the scatter larger; this bounds what one update may cost.
_MOST_STEPS = 100
# Power iteration stops earlier where a step no longer changes the cut.
_POWER_STEPS = 10
# A split of n members has settled when fewer than n / 64 change sides: the means would hardly move.
_SETTLED_SHARE = 64
# Up to so many members, many starts are tried at once. On recordings, one split in five ended at a worse
# 2-means from two or three starts than from scikit-learn's ten random ones; from 24 starts, one in a hundred.
_MANY_STARTS_SIZE = 128
_STARTS = 24
# The side taken at a split is one bit of an int64. Deeper splits share the last bit: their guess is worse.
_DEEPEST = 62
# The leading direction is compared at every so many calls: at each it would cost two more products.
_CALLS_PER_CHECK = 5


@dataclass(frozen=True)
class _Halves:
    second: Bools
    # What (3.6) minimises, less the same constant for every split.
    scatter: float
    # Product of each row with the difference of the means: the larger, the nearer to the second.
    score: Floats


@dataclass(frozen=True)
class _Cluster:
    """Some rows and columns of a matrix, not gathered yet.

    Attributes
    ----------
    matrix, rows
        A matrix, and intp [n], its rows and columns.
    members
        intp [n]: which trajectories they are.
    unchanged
        bool [n]: those that all splits so far have put where the last call did.
    depth
        Number of splits so far.
    """

    matrix: Matrix
    rows: Slots
    members: Slots
    unchanged: Bools
    depth: int


class DivisiveKMeans:
    """Clusters whose smallest affinity is above `stop_affinity`.

    The splits of one call are the first guess of the next: of a large cluster, two products with the
    matrix confirm that it still is a best split, and two more, at every fifth call, that the leading
    direction gives the same.
    """

    def __init__(self, stop_affinity: float) -> None:
        # As the affinities are: in single precision.
        self._stop_affinity = float(np.float32(stop_affinity))
        # Of each row of the matrix: sides taken at the splits of the last call, the first in the lowest bit,
        # and how many splits there were.
        self._sides: NDArray[np.int64] = np.zeros(0, np.int64)
        self._splits: NDArray[np.int64] = np.zeros(0, np.int64)
        self._rooms: list[Matrix] = []
        self._calls = 0

    def __call__(self, affinity: Affinity) -> tuple[NDArray[np.intp], Floats]:
        """Labels of the trajectories, intp [n], and the sum of affinities of each inside its cluster."""
        self._calls += 1
        labels, inside = np.zeros(len(affinity), np.intp), np.zeros(len(affinity))
        self._fit(len(affinity.matrix))
        order = np.argsort(affinity.rows)
        everyone = _Cluster(affinity.matrix, affinity.rows[order], order, np.ones(len(order), np.bool_), 0)
        pending = [everyone] if len(order) else []
        found = 0
        while pending:
            cluster = pending.pop()
            halves, sums = self._split(cluster, affinity.rows[cluster.members])
            pending += halves
            if not halves:
                labels[cluster.members], inside[cluster.members] = found, sums
                found += 1
        return labels, inside

    def _fit(self, rows: int) -> None:
        extra = rows - len(self._sides)
        if extra > 0:
            self._sides, self._splits = np.pad(self._sides, (0, extra)), np.pad(self._splits, (0, extra))

    def _split(self, cluster: _Cluster, rows: Slots) -> tuple[list[_Cluster], Floats]:
        """The halves of a cluster, none where it holds no weak edge; and the sums of its rows."""
        depth, bit = cluster.depth, 1 << min(cluster.depth, _DEEPEST)
        sides, unchanged = self._sides[rows], cluster.unchanged & (self._splits[rows] > depth)
        side = (sides & bit) > 0
        guess = side & unchanged
        matrix, totals = Submatrix.gathered(cluster.matrix, cluster.rows, self._room(depth, len(rows)), guess)
        if len(matrix) == 1 or totals.least > self._stop_affinity:
            self._splits[rows] = depth
            return [], totals.sums
        thorough = (self._calls + depth) % _CALLS_PER_CHECK == 0
        second = halve(matrix, totals, guess, thorough=thorough)
        self._sides[rows] = np.where(second, sides | bit, sides & ~bit)
        unchanged &= side == second
        halves = [
            _Cluster(matrix.matrix, chosen, cluster.members[chosen], unchanged[chosen], depth + 1)
            for chosen in (np.flatnonzero(second), np.flatnonzero(~second))
        ]
        return halves, totals.sums

    def _room(self, depth: int, size: int) -> Matrix:
        """Where the cluster of a depth goes: there is one of each at a time."""
        if len(self._rooms) == depth:
            self._rooms.append(room_for(0))
        if len(self._rooms[depth]) < size:
            self._rooms[depth] = room_for(size)
        return self._rooms[depth]


def halve(matrix: Submatrix, totals: Totals, guess: Bools, *, thorough: bool = True) -> Bools:
    """2-means (3.6) on the rows of a matrix, not all equal; bool [n], neither half empty.

    Parameters
    ----------
    matrix
        At least two members.
    totals
        Sums of its rows, and over the columns of `guess`.
    guess
        bool [n]: a first guess at one half; all alike for none.
    thorough
        Whether a good guess is compared with the leading direction as well.
    """
    n, sums = len(matrix), totals.sums
    if n == 2:
        return np.array([False, True])
    if n <= _MANY_STARTS_SIZE:
        return _best_of_many(matrix, sums, guess)
    starts = []
    if guess.any() and not guess.all():
        starts = [_two_means(matrix, sums, guess, totals.part)]
        known = starts[0]
        if not thorough and _apart(guess, known.second) <= n // _SETTLED_SHARE:
            return known.second
        if _apart(_leading_cut(matrix, known.score, 1), known.second) <= n // _SETTLED_SHARE:
            return known.second
    starts.append(_two_means(matrix, sums, _least_alike(matrix, sums)))
    leading = _leading_cut(matrix, starts[-1].score, _POWER_STEPS)
    if all(_apart(leading, known.second) for known in starts):
        starts.append(_two_means(matrix, sums, leading))
    return min(starts, key=lambda halves: halves.scatter).second


def _best_of_many(matrix: Submatrix, sums: Floats, guess: Bools) -> Bools:
    """2-means of a small matrix from the guess and from around many of its rows, all at once."""
    n = len(matrix)
    rows = matrix.rows()
    first = np.unique(np.linspace(0, n - 1, _STARTS).astype(np.intp))
    # Halves around a row and the one least like it.
    last = rows[first].argmin(1)
    middle = (np.square(rows[last]).sum(1) - np.square(rows[first]).sum(1)) / 2
    second = rows @ (rows[last] - rows[first]).T > middle
    second[last, np.arange(len(last))] = True
    second[first, np.arange(len(first))] = False
    second = np.column_stack([guess, _least_alike(matrix, sums), second])
    second = second[:, second.any(0) & ~second.all(0)]
    for _ in range(_MOST_STEPS):
        second = _distinct(second)
        half, count = rows @ second, second.sum(0)
        mean, other = (sums[:, None] - half) / (n - count), half / count
        lengths = np.square(mean).sum(0), np.square(other).sum(0)
        scatter = -(n - count) * lengths[0] - count * lengths[1]
        closer = rows @ (other - mean) > (lengths[1] - lengths[0]) / 2
        closer = np.where(closer.all(0) | ~closer.any(0), second, closer)
        if np.array_equal(closer, second):
            break
        second = closer
    return np.asarray(second[:, scatter.argmin()])


def _distinct(splits: Bools) -> Bools:
    """The columns that differ, each where it first is: most starts soon meet."""
    first: dict[bytes, int] = {}
    for k, split in enumerate(np.packbits(splits.T, axis=1)):
        first.setdefault(split.tobytes(), k)
    return splits[:, list(first.values())]


def _two_means(matrix: Submatrix, sums: Floats, second: Bools, half: Floats | None = None) -> _Halves:
    """Move rows to the nearer of the two means until hardly one moves; `half`: the product with `second`."""
    n = len(matrix)
    for _ in range(_MOST_STEPS):
        half = matrix.times(second) if half is None else half
        across, threshold, scatter = means(sums, half, int(second.sum()))
        score = matrix.times(across)
        closer, count, moved = nearer(score, threshold, second)
        if not 0 < count < n:
            break
        second, half = closer, None
        if moved <= n // _SETTLED_SHARE:
            break
    return _Halves(second, scatter, score)


def _least_alike(matrix: Submatrix, sums: Floats) -> Bools:
    """Halves around the row that is least like all others, and the one least like it."""
    first = matrix.row(int(sums.argmin()))
    last = matrix.row(int(first.argmin()))
    score = matrix.times(last - first)
    second = score > (last @ last - first @ first) / 2
    return second if second.any() and not second.all() else first < first.max()


def _leading_cut(matrix: Submatrix, score: Floats, steps: int) -> Bools:
    """Halves along the direction in which the rows vary most, by power iteration from a first guess."""
    halves = cut(score)
    for _ in range(steps):
        direction = matrix.times(score - score.mean())
        score = matrix.times(direction / max(np.abs(direction).max(), np.finfo(np.float64).tiny))
        before, halves = halves, cut(score)
        if not _apart(before, halves):
            break
    return halves


def _apart(one: Bools, other: Bools) -> int:
    """How many would have to change sides to make two splits the same."""
    differ = int((one != other).sum())
    return min(differ, len(one) - differ)
