"""Divisive k-means (3.6): halve the affinity graph while a cluster holds a weak edge.

A cluster is split by 2-means on its rows of the affinity matrix. The edges between the halves are cut,
so that from there on each half sees its own columns alone.

Both steps of 2-means are products with the matrix A of the cluster: with the indicator h of one half,
A·h gives the means of both halves, and A·(difference of the means) says which is nearer.
"""

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Floats32, Ints, Slots
from .kernels import combine_rows

# 2-means always ends, since no step makes the scatter larger; this bounds what one update may cost.
_MAX_STEPS = 100
# A split of n members has settled when fewer than n / 64 change sides: the means would hardly move.
_SETTLED_SHARE = 64
# Starts of 2-means up to so many members; of more members fewer starts take as long. On recordings, one split
# in five ended at a worse 2-means from two or three starts than from scikit-learn's ten random ones; from 24
# starts, one in a hundred.
_STARTS, _MANY_STARTS_SIZE = 24, 128
# Rows per part in which a weak edge is looked for: most clusters that have one have one in the first.
_ROWS_AT_ONCE = 64


class DivisiveKMeans:
    """Clusters whose smallest affinity is above `stop_affinity`.

    The splits of one call are the first guess of the next: of a large cluster, two products with the matrix
    confirm that nothing moves.
    """

    def __init__(self, stop_affinity: float) -> None:
        # As the affinities are: in single precision.
        self._stop_affinity = float(np.float32(stop_affinity))
        # By depth, int8 [slots]: the side that each took at the split of the last call, 1 or -1; 0 for none.
        self._sides: list[NDArray[np.int8]] = []

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
        labels, inside, everyone = np.zeros(n, np.intp), np.zeros(n), np.arange(n)
        # Members of a cluster, the sum of affinities of each inside it, and how often it was split off.
        pending = [(everyone, _times(affinity, everyone, np.ones(n)), 0)] if n else []
        before, self._sides = self._sides, []
        found = 0
        while pending:
            members, sums, depth = pending.pop()
            if not self._holds_weak_edge(affinity, members):
                labels[members], inside[members] = found, sums
                found += 1
                continue
            mine = slots[members]
            known = before[depth] if depth < len(before) else np.zeros(0, np.int8)
            guess = np.append(known, np.int8(0))[np.minimum(mine, len(known))]
            of = affinity, members, sums, guess
            second, to_second = _confirmed(*of) or _searched(*of)
            if depth == len(self._sides):
                self._sides.append(np.zeros(int(slots.max()) + 1, np.int8))
            self._sides[depth][mine] = np.where(second, 1, -1)
            pending.append((members[second], to_second[second], depth + 1))
            pending.append((members[~second], (sums - to_second)[~second], depth + 1))
        return labels, inside

    def _holds_weak_edge(self, affinity: Floats32, members: Ints) -> bool:
        parts = (members[k : k + _ROWS_AT_ONCE] for k in range(0, len(members), _ROWS_AT_ONCE))
        least = (affinity[part].take(members, 1).min() for part in parts)
        return len(members) > 1 and any(value <= self._stop_affinity for value in least)


def _times(affinity: Floats32, members: Ints, factors: Floats) -> Floats:
    """Product of the rows and columns of m members with factors, float64 [m]; rows times 0 are not read."""
    out, some = np.zeros(len(affinity)), factors != 0
    combine_rows(affinity, members[some], factors[some], out)
    return out[members]


def _sums_to(affinity: Floats32, members: Ints, sums: Floats, second: Bools) -> Floats:
    """Sum of the affinities of each of m members to those of one half, float64 [m]."""
    if 2 * np.count_nonzero(second) <= len(second):
        return _times(affinity, members, second.astype(np.float64))
    return sums - _times(affinity, members, (~second).astype(np.float64))


def _confirmed(
    affinity: Floats32, members: Ints, sums: Floats, guess: NDArray[np.int8]
) -> tuple[Bools, Floats] | None:
    """One step of 2-means from a guess at a large cluster; None if it has not settled.

    Returns
    -------
    second, to_second
        bool [m], and float64 [m]: the sums of affinities to that half.
    """
    n, high = len(members), guess > 0
    count, settled = np.count_nonzero(high), len(members) // _SETTLED_SHARE
    if n <= _MANY_STARTS_SIZE or not 0 < count < n or np.count_nonzero(guess == 0) > settled:
        return None
    half = _sums_to(affinity, members, sums, high)
    mean, other = (sums - half) / (n - count), half / count
    closer: Bools = _times(affinity, members, other - mean) > (other @ other - mean @ mean) / 2
    moved = closer.astype(np.float64) - high
    if np.count_nonzero(moved * guess) > settled or closer.all() or not closer.any():
        return None
    return closer, half + _times(affinity, members, moved)


def _searched(
    affinity: Floats32, members: Ints, sums: Floats, guess: NDArray[np.int8]
) -> tuple[Bools, Floats]:
    """As :func:`_confirmed`, by 2-means from several starts."""
    part = affinity if len(members) == len(affinity) else affinity.take(members, 0).take(members, 1)
    second = halve(part, sums, guess)
    return second, _sums_to(affinity, members, sums, second)


def halve(affinity: Floats32, sums: Floats, guess: NDArray[np.int8]) -> Bools:
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
    for _ in range(_MAX_STEPS):
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
