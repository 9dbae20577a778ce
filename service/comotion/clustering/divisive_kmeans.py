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

from ..affinity import Affinity, Matrix
from ..window import Bools, Floats, Slots
from .block import Block

_MOST_STEPS = 100
_POWER_STEPS = 10
_CUT_STEPS = 3
# A part of the members that may change sides without the means being computed anew.
_FEW = 64
# So few that many starts are tried, whatever the guess is worth.
_SMALL = 128
_STARTS = 24
_DEEPEST = 62
_CALLS_PER_CHECK = 5


@dataclass(frozen=True)
class _Halves:
    second: Bools
    # What (3.6) minimises, less the same constant for every split.
    scatter: float
    # How far each row is towards the second half's mean.
    score: Floats


@dataclass(frozen=True)
class _Cluster:
    """A part of a block, not copied out yet; `along`: who was with the same others in the last call."""

    block: Block
    chosen: Slots
    members: Slots
    along: Bools
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
        # Of each place: sides taken at the splits of the last call, the first in the lowest bit.
        self._sides: NDArray[np.int64] = np.zeros(0, np.int64)
        self._splits: NDArray[np.int64] = np.zeros(0, np.int64)
        self._rooms: list[Matrix] = []
        self._calls = 0

    def __call__(self, affinity: Affinity) -> tuple[NDArray[np.intp], Floats]:
        """Labels of the trajectories, intp [n], and the sum of affinities of each inside its cluster."""
        self._calls += 1
        labels, inside = np.zeros(len(affinity), np.intp), np.zeros(len(affinity))
        extra = max(0, len(affinity.matrix) - len(self._sides))
        self._sides, self._splits = np.pad(self._sides, (0, extra)), np.pad(self._splits, (0, extra))
        block, order = Block.of(affinity)
        everyone = np.arange(len(order))
        pending = [_Cluster(block, everyone, order, np.ones(len(order), np.bool_), 0)] if len(order) else []
        found = 0
        while pending:
            cluster = pending.pop()
            halves, sums = self._split(cluster, affinity.places[cluster.members])
            pending += halves
            if not halves:
                labels[cluster.members], inside[cluster.members] = found, sums
                found += 1
        return labels, inside

    def _split(self, cluster: _Cluster, places: Slots) -> tuple[list[_Cluster], Floats]:
        """The halves of a cluster, none where it holds no weak edge; and the sums of its rows."""
        depth, block = cluster.depth, self._copied(cluster)
        sums, least = block.times(np.ones(len(block)))
        if len(block) == 1 or least > self._stop_affinity:
            self._splits[places] = depth
            return [], sums
        bit = 1 << min(depth, _DEEPEST)
        along = cluster.along & (self._splits[places] > depth)
        side = (self._sides[places] & bit) > 0
        thorough = (self._calls + depth) % _CALLS_PER_CHECK == 0
        second = halve(block, sums, side & along, thorough=thorough)
        self._sides[places] = np.where(second, self._sides[places] | bit, self._sides[places] & ~bit)
        along &= side == second
        halves = [
            _Cluster(block, chosen, cluster.members[chosen], along[chosen], depth + 1)
            for chosen in (np.flatnonzero(second), np.flatnonzero(~second))
        ]
        return halves, sums

    def _copied(self, cluster: _Cluster) -> Block:
        """A cluster as a block. Of each depth there is one at a time, so each has one room."""
        n, depth = len(cluster.chosen), cluster.depth
        if n == len(cluster.block):
            return cluster.block
        self._rooms += [np.zeros((0, 0), np.float32)] * (depth - len(self._rooms))
        if cluster.block.is_sparse(n) and len(self._rooms[depth - 1]) < n:
            self._rooms[depth - 1] = np.empty((n + n // 8, n + n // 8), np.float32)
        return cluster.block.part(cluster.chosen, self._rooms[depth - 1])


def halve(block: Block, sums: Floats, guess: Bools, *, thorough: bool = True) -> Bools:
    """2-means on the rows of a block, not all equal; bool [n], neither half empty.

    Parameters
    ----------
    block
        At least two members.
    sums
        float64 [n], of its rows.
    guess
        bool [n]: a first guess at one half; all alike for none.
    thorough
        Whether a good guess is compared with the leading direction as well.
    """
    n = len(block)
    if n == 2:
        return np.array([False, True])
    if n <= _SMALL:
        return _best_of_many(block, sums, guess)
    starts = []
    if guess.any() and not guess.all():
        starts = [_two_means(block, sums, guess)]
        known = starts[0]
        if not thorough and _apart(guess, known.second) <= n // _FEW:
            return known.second
        if _apart(_leading_cut(block, known.score, 1), known.second) <= n // _FEW:
            return known.second
    starts.append(_two_means(block, sums, _least_alike(block, sums)))
    cut = _leading_cut(block, starts[-1].score, _POWER_STEPS)
    if all(_apart(cut, known.second) for known in starts):
        starts.append(_two_means(block, sums, cut))
    return min(starts, key=lambda halves: halves.scatter).second


def _best_of_many(block: Block, sums: Floats, guess: Bools) -> Bools:
    """2-means of a small block from the guess and from around many of its rows, all at once."""
    n = len(block)
    rows = np.stack([block.row(i) for i in range(n)])
    first = np.unique(np.linspace(0, n - 1, _STARTS).astype(np.intp))
    # Halves around a row and the one least like it.
    last = rows[first].argmin(1)
    middle = (np.square(rows[last]).sum(1) - np.square(rows[first]).sum(1)) / 2
    second = rows @ (rows[last] - rows[first]).T > middle
    second[last, np.arange(len(last))] = True
    second[first, np.arange(len(first))] = False
    second = np.column_stack([guess, _least_alike(block, sums), second])
    second = second[:, second.any(0) & ~second.all(0)]
    for _ in range(_MOST_STEPS):
        half, count = rows @ second, second.sum(0)
        mean, other = (sums[:, None] - half) / (n - count), half / count
        lengths = np.square(mean).sum(0), np.square(other).sum(0)
        scatter = -(n - count) * lengths[0] - count * lengths[1]
        nearer = rows @ (other - mean) > (lengths[1] - lengths[0]) / 2
        nearer = np.where(nearer.all(0) | ~nearer.any(0), second, nearer)
        if np.array_equal(nearer, second):
            break
        second = nearer
    return np.asarray(second[:, scatter.argmin()])


def _two_means(block: Block, sums: Floats, second: Bools) -> _Halves:
    """Move rows to the nearer of the two means until none moves."""
    n = len(block)
    for _ in range(_MOST_STEPS):
        half, _least = block.times(second)
        mean, other = (sums - half) / (n - second.sum()), half / second.sum()
        scatter = -(n - second.sum()) * (mean @ mean) - second.sum() * (other @ other)
        score, _least = block.times(other - mean)
        nearer = score > (other @ other - mean @ mean) / 2
        if nearer.all() or not nearer.any():
            break
        moved = int((nearer != second).sum())
        second = nearer
        if moved <= n // _FEW:
            break
    return _Halves(second, float(scatter), score)


def _least_alike(block: Block, sums: Floats) -> Bools:
    """Halves around the row that is least like all others, and the one least like it."""
    first = block.row(int(sums.argmin()))
    last = block.row(int(first.argmin()))
    score, _ = block.times(last - first)
    second = score > (last @ last - first @ first) / 2
    return second if second.any() and not second.all() else first < first.max()


def _leading_cut(block: Block, score: Floats, steps: int) -> Bools:
    """Halves along the direction in which the rows vary most, by power iteration from a first guess."""
    cut = _cut(score)
    for _ in range(steps):
        direction, _least = block.times(score - score.mean())
        score, _least = block.times(direction / max(np.abs(direction).max(), np.finfo(np.float64).tiny))
        before, cut = cut, _cut(score)
        if not _apart(before, cut):
            break
    return cut


def _cut(score: Floats) -> Bools:
    """Two halves of numbers, about the middle of the means of the halves; the least alone if need be."""
    threshold, second = score.mean(), np.zeros(len(score), np.bool_)
    for _ in range(_CUT_STEPS):
        second = np.asarray(score > threshold)
        if second.all() or not second.any():
            return np.asarray(score > score.min())
        threshold = (score[second].mean() + score[~second].mean()) / 2
    return second


def _apart(one: Bools, other: Bools) -> int:
    """How many would have to change sides to make two splits the same."""
    differ = int((one != other).sum())
    return min(differ, len(one) - differ)
