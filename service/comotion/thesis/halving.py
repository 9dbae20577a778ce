"""Divisive k-means (3.6): halve the affinity graph while a cluster holds a weak edge.

A cluster is split by 2-means on its rows of the affinity matrix. The edges between the halves are cut,
so that from there on each half sees its own columns alone.

Both steps of 2-means are products with the matrix A of the cluster: with the indicator h of one half,
A·h gives the means of both halves, and A·(difference of the means) says which is nearer.
"""

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Floats32, Ints, Slots
from .kernels import sum_inside

Sides = NDArray[np.int8]
"""At a split, the half in which each trajectory is: 1 or -1, 0 where it has no part or is not known."""
# 2-means always ends, since no step makes the scatter larger; this bounds what one update may cost.
_MOST_STEPS = 100
# A split of n members has settled when fewer than n / 64 change sides: the means would hardly move.
_SETTLED_SHARE = 64
# Starts of 2-means up to so many members; of more members fewer starts take as long. On recordings, one split
# in five ended at a worse 2-means from two or three starts than from scikit-learn's ten random ones; from 24
# starts, one in a hundred.
_STARTS, _MANY_STARTS_SIZE = 24, 128
_NO_SPLIT = -1


class DivisiveKMeans:
    """Clusters whose smallest affinity is above `stop_affinity`.

    The splits of one call are the first guess of the next: one step of 2-means, of all large ones together,
    confirms those in which nothing moves.
    """

    def __init__(self, stop_affinity: float) -> None:
        # As the affinities are: in single precision.
        self._stop_affinity = float(np.float32(stop_affinity))
        # Of the last call, int8 [splits + 1, slots], and which split each half was divided by. The last row
        # is that of :data:`_NO_SPLIT`.
        self._sides: Sides = np.zeros((1, 1), np.int8)
        self._children = [[_NO_SPLIT, _NO_SPLIT]]

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
        labels, inside, found = np.zeros(n, np.intp), np.zeros(n), 0
        known, children = self._known(slots), list[list[int]]()
        closer, sides = _one_step(affinity, known), list[Sides]()
        # Members, the split of the last call, and of which new split they are which half.
        pending = [(np.arange(n), 0, _NO_SPLIT, 0)] if n else []
        while pending:
            members, last, parent, half = pending.pop()
            if sum_inside(affinity, members, self._stop_affinity, inside):
                labels[members], found = found, found + 1
                continue
            second = closer[last, members]
            if not _settled(known[last], members, second):
                second = _searched(affinity, members, known[last, members])
            if parent != _NO_SPLIT:
                children[parent][half] = len(sides)
            side = np.zeros(n, np.int8)
            side[members] = np.where(second, 1, -1)
            following = self._children[last]
            pending.append((members[second], following[1], len(sides), 1))
            pending.append((members[~second], following[0], len(sides), 0))
            sides.append(side)
            children.append([_NO_SPLIT, _NO_SPLIT])
        self._sides = np.zeros((len(sides) + 1, int(slots.max(initial=0)) + 1), np.int8)
        for split, side in enumerate(sides):
            self._sides[split, slots] = side
        self._children = [*children, [_NO_SPLIT, _NO_SPLIT]]
        return labels, inside

    def _known(self, slots: Slots) -> Sides:
        """Sides of slots intp [n] at the splits of the last call, int8 [splits + 1, n]."""
        held = slots < self._sides.shape[1]
        return np.asarray(self._sides[:, np.where(held, slots, 0)] * held, np.int8)


def _one_step(affinity: Floats32, known: Sides) -> Bools:
    """One step of 2-means from a first guess at each of some splits: who is nearer to the second half.

    bool [splits, n], as `known` is; False for splits that are not large.
    """
    closer, large = np.zeros(known.shape, np.bool_), (known != 0).sum(1) > _MANY_STARTS_SIZE
    if large.any():
        halves = np.stack([known[large] < 0, known[large] > 0]).astype(np.float32)
        shares = halves / np.maximum(halves.sum(2, keepdims=True), 1)
        means = (shares.reshape(-1, len(affinity)) @ affinity).reshape(halves.shape)
        mean, other = means * halves.sum(0)
        middle = (np.square(other).sum(1) - np.square(mean).sum(1)) / 2
        closer[large] = (other - mean) @ affinity > middle[:, None]
    return closer


def _settled(known: Sides, members: Ints, second: Bools) -> bool:
    """Whether a step of :func:`_one_step` at a large split has moved nearly nobody.

    Its members must be nearly those of the last call.
    """
    guess, few = known[members], len(members) // _SETTLED_SHARE
    new, gone = np.count_nonzero(guess == 0), np.count_nonzero(known) - np.count_nonzero(guess)
    moved = np.count_nonzero(np.where(second, guess < 0, guess > 0))
    large = len(members) > _MANY_STARTS_SIZE
    return large and max(new, gone, moved) <= few and bool(second.any() and not second.all())


def _searched(affinity: Floats32, members: Ints, guess: Sides) -> Bools:
    """2-means of some members from several starts."""
    part = affinity if len(members) == len(affinity) else affinity.take(members, 0).take(members, 1)
    return halve(part, part.sum(1, dtype=np.float64), guess)


def halve(affinity: Floats32, sums: Floats, guess: Sides) -> Bools:
    """2-means (3.6) on the rows of a matrix, not all equal; bool [n], neither half empty.

    Parameters
    ----------
    affinity
        float32 [n, n], symmetric, n of 2 or more.
    sums
        float [n], of its rows.
    guess
        int8 [n]: a first guess, 1 and -1 for the halves; 0 where nothing is known.
    """
    n = len(affinity)
    if n == 2:
        return np.array([False, True])
    small = n <= _MANY_STARTS_SIZE
    rows = affinity.astype(np.float64) if small else affinity
    starts, high, low = np.zeros((n, 0), np.bool_), guess > 0, guess < 0
    if high.any() and low.any():
        # What is not known yet is where it is nearer.
        halves = _product(rows, np.column_stack([low, high])) / [low.sum(), high.sum()]
        nearer = _product(rows, halves[:, 1:] - halves[:, :1]) > np.diff(np.square(halves).sum(0)) / 2
        starts = nearer if 0 < nearer.sum() < n else high[:, None]
    count = _STARTS if small else max(_STARTS * _MANY_STARTS_SIZE // n, 2)
    starts = np.hstack([starts, _around_rows(rows, sums, count)])
    return _two_means(rows, sums, starts[:, starts.any(0) & ~starts.all(0)])


def _around_rows(rows: Floats | Floats32, sums: Floats, count: int) -> Bools:
    """Halves around some rows and the one least like all, each against the one least like it, bool [n, m]."""
    first = np.unique([*np.linspace(0, len(rows) - 1, count).astype(np.intp), sums.argmin()])
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


def _two_means(rows: Floats | Floats32, sums: Floats, second: Bools) -> Bools:
    """The best of 2-means from some starts, bool [n].

    Parameters
    ----------
    rows, sums
        float [n, n] and [n].
    second
        bool [n, starts], first guesses at one half, neither of them empty.
    """
    n = len(rows)
    settled = 0 if n <= _MANY_STARTS_SIZE else n // _SETTLED_SHARE
    for _ in range(_MOST_STEPS):
        second = _distinct(second)
        half, count = _product(rows, second), second.sum(0)
        mean, other = (sums[:, None] - half) / (n - count), half / count
        lengths = np.square(mean).sum(0), np.square(other).sum(0)
        # What (3.6) minimises, less the same constant for every split.
        scatter = -(n - count) * lengths[0] - count * lengths[1]
        closer = _product(rows, other - mean) > (lengths[1] - lengths[0]) / 2
        closer = np.where(closer.all(0) | ~closer.any(0), second, closer)
        moved, second = (closer != second).sum(0), closer
        if moved.max() <= settled:
            break
    return np.asarray(second[:, int(scatter.argmin())])


def _product(rows: Floats | Floats32, other: Floats | Bools) -> Floats:
    """Of a matrix and columns, in the precision of the matrix."""
    product: Floats = (rows @ other.astype(rows.dtype)).astype(np.float64)
    return product
