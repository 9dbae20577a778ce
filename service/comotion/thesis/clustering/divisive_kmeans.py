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
from ...compiled import compiled
from ..affinity import Affinity, Matrix
from .block import Block, Survey, room_for

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
    """Some rows and columns of a matrix, not gathered yet.

    `members` intp [n]: which trajectories they are; `along` bool [n]: who was with the same others in
    the last call.
    """

    matrix: Matrix
    rows: Slots
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
        self._fit(len(affinity.matrix))
        order = np.argsort(affinity.places)
        everyone = _Cluster(affinity.matrix, affinity.places[order], order, np.ones(len(order), np.bool_), 0)
        pending = [everyone] if len(order) else []
        found = 0
        while pending:
            cluster = pending.pop()
            halves, sums = self._split(cluster, affinity.places[cluster.members])
            pending += halves
            if not halves:
                labels[cluster.members], inside[cluster.members] = found, sums
                found += 1
        return labels, inside

    def _fit(self, places: int) -> None:
        extra = places - len(self._sides)
        if extra > 0:
            self._sides, self._splits = np.pad(self._sides, (0, extra)), np.pad(self._splits, (0, extra))

    def _split(self, cluster: _Cluster, places: Slots) -> tuple[list[_Cluster], Floats]:
        """The halves of a cluster, none where it holds no weak edge; and the sums of its rows."""
        depth, bit = cluster.depth, 1 << min(cluster.depth, _DEEPEST)
        sides, along = self._sides[places], cluster.along & (self._splits[places] > depth)
        side = (sides & bit) > 0
        guess = side & along
        block, survey = Block.gathered(cluster.matrix, cluster.rows, self._room(depth, len(places)), guess)
        if len(block) == 1 or survey.least > self._stop_affinity:
            self._splits[places] = depth
            return [], survey.sums
        thorough = (self._calls + depth) % _CALLS_PER_CHECK == 0
        second = halve(block, survey, guess, thorough=thorough)
        self._sides[places] = np.where(second, sides | bit, sides & ~bit)
        along &= side == second
        halves = [
            _Cluster(block.matrix, chosen, cluster.members[chosen], along[chosen], depth + 1)
            for chosen in (np.flatnonzero(second), np.flatnonzero(~second))
        ]
        return halves, survey.sums

    def _room(self, depth: int, size: int) -> Matrix:
        """Where the cluster of a depth goes: there is one of each at a time."""
        if len(self._rooms) == depth:
            self._rooms.append(room_for(0))
        if len(self._rooms[depth]) < size:
            self._rooms[depth] = room_for(size)
        return self._rooms[depth]


def halve(block: Block, survey: Survey, guess: Bools, *, thorough: bool = True) -> Bools:
    """2-means on the rows of a block, not all equal; bool [n], neither half empty.

    Parameters
    ----------
    block
        At least two members.
    survey
        Of the block, and of what is guessed.
    guess
        bool [n]: a first guess at one half; all alike for none.
    thorough
        Whether a good guess is compared with the leading direction as well.
    """
    n, sums = len(block), survey.sums
    if n == 2:
        return np.array([False, True])
    if n <= _SMALL:
        return _best_of_many(block, sums, guess)
    starts = []
    if guess.any() and not guess.all():
        starts = [_two_means(block, sums, guess, survey.part)]
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
    rows = block.rows()
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
        second = _distinct(second)
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


def _distinct(splits: Bools) -> Bools:
    """The columns that differ, each where it first is: most starts soon meet."""
    first: dict[bytes, int] = {}
    for k, split in enumerate(np.packbits(splits.T, axis=1)):
        first.setdefault(split.tobytes(), k)
    return splits[:, list(first.values())]


def _two_means(block: Block, sums: Floats, second: Bools, half: Floats | None = None) -> _Halves:
    """Move rows to the nearer of the two means until none moves; `half`: the product with `second`."""
    n = len(block)
    for _ in range(_MOST_STEPS):
        half = block.times(second) if half is None else half
        across, threshold, scatter = _means(sums, half, int(second.sum()))
        score = block.times(across)
        nearer, count, moved = _nearer(score, threshold, second)
        if not 0 < count < n:
            break
        second, half = nearer, None
        if moved <= n // _FEW:
            break
    return _Halves(second, scatter, score)


@compiled()
def _means(sums: Floats, half: Floats, count: int) -> tuple[Floats, float, float]:
    """From the sums of all rows and of `count` of them: the way from the first half's mean to the other.

    Also, what a row's product with it must exceed for the other to be nearer; and the scatter.
    """
    n, across = len(sums), np.empty(len(sums))
    first, second = 0.0, 0.0
    for i in range(n):
        mean, other = (sums[i] - half[i]) / (n - count), half[i] / count
        first += mean * mean
        second += other * other
        across[i] = other - mean
    return across, (second - first) / 2, -(n - count) * first - count * second


@compiled()
def _nearer(score: Floats, threshold: float, second: Bools) -> tuple[Bools, int, int]:
    """Rows nearer to the second mean; how many they are, and how many rows have changed sides."""
    nearer, count, moved = np.empty(len(score), np.bool_), 0, 0
    for i in range(len(score)):
        nearer[i] = score[i] > threshold
        count += nearer[i]
        moved += nearer[i] != second[i]
    return nearer, count, moved


def _least_alike(block: Block, sums: Floats) -> Bools:
    """Halves around the row that is least like all others, and the one least like it."""
    first = block.row(int(sums.argmin()))
    last = block.row(int(first.argmin()))
    score = block.times(last - first)
    second = score > (last @ last - first @ first) / 2
    return second if second.any() and not second.all() else first < first.max()


def _leading_cut(block: Block, score: Floats, steps: int) -> Bools:
    """Halves along the direction in which the rows vary most, by power iteration from a first guess."""
    cut = _cut(score)
    for _ in range(steps):
        direction = block.times(score - score.mean())
        score = block.times(direction / max(np.abs(direction).max(), np.finfo(np.float64).tiny))
        before, cut = cut, _cut(score)
        if not _apart(before, cut):
            break
    return cut


@compiled()
def _cut(score: Floats) -> Bools:
    """Two halves of numbers, about the middle of the means of the halves; the least alone if need be."""
    n = len(score)
    lonely: Bools = score > score.min()
    threshold, second = score.mean(), lonely
    for _ in range(_CUT_STEPS):
        sums, count = np.zeros(2), 0
        for x in score:
            sums[int(x > threshold)] += x
            count += x > threshold
        if not 0 < count < n:
            return lonely
        second = score > threshold
        threshold = (sums[1] / count + sums[0] / (n - count)) / 2
    return second


def _apart(one: Bools, other: Bools) -> int:
    """How many would have to change sides to make two splits the same."""
    differ = int((one != other).sum())
    return min(differ, len(one) - differ)
