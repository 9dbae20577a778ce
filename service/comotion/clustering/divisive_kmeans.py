"""Divisive k-means (3.6): halve the affinity graph while a cluster holds a weak edge."""

import numpy as np
from numpy.typing import NDArray

from ..window import Bools, Floats

_POWER_STEPS = 10
_MOST_STEPS = 100


def divide(affinity: Floats, stop_affinity: float) -> NDArray[np.intp]:
    """Clusters whose smallest affinity is above `stop_affinity`, labels intp [N].

    A cluster is split by 2-means on its rows of the affinity matrix. The edges between the halves
    are cut, so that from there on each half sees its own columns alone.
    """
    labels = np.zeros(len(affinity), np.intp)
    pending = [np.arange(len(affinity))]
    found = 0
    while pending:
        members = pending.pop()
        rows = affinity[np.ix_(members, members)]
        if rows.size and rows.min() <= stop_affinity:
            second = halve(rows)
            pending += [members[second], members[~second]]
        else:
            labels[members] = found
            found += 1
    return labels


def halve(rows: Floats) -> Bools:
    """2-means on rows [n, n], not all equal; bool [n], neither half empty.

    Of two starts the better end is kept. That finds what scikit-learn's KMeans finds with ten random
    ones, in a tenth of the time, and the same every time.
    """
    ends = [_lloyd(rows, start) for start in (_least_alike(rows), _principal_axis(rows))]
    return min(ends, key=lambda second: _scatter(rows, second))


def _least_alike(rows: Floats) -> Bools:
    """Halves around the two trajectories of the smallest affinity."""
    i, j = np.unravel_index(int(rows.argmin()), rows.shape)
    nearer: Bools = ((rows - rows[j]) ** 2).sum(axis=1) < ((rows - rows[i]) ** 2).sum(axis=1)
    return nearer


def _principal_axis(rows: Floats) -> Bools:
    """Halves to both sides of the mean, along the axis on which the rows vary most."""
    centred = rows - rows.mean(axis=0)
    axis = centred[(centred**2).sum(axis=1).argmax()]
    for _ in range(_POWER_STEPS):
        axis = centred.T @ (centred @ axis)
        axis /= np.linalg.norm(axis)
    beyond: Bools = centred @ axis > 0
    return beyond


def _lloyd(rows: Floats, second: Bools) -> Bools:
    """Move rows to the nearer of the two means until none moves."""
    for _ in range(_MOST_STEPS):
        mean, other = rows[~second].mean(axis=0), rows[second].mean(axis=0)
        nearer = rows @ (other - mean) > (other @ other - mean @ mean) / 2
        if (nearer == second).all() or nearer.all() or not nearer.any():
            break
        second = nearer
    return second


def _scatter(rows: Floats, second: Bools) -> float:
    """What (3.6) minimises, less the same constant for every split."""
    halves = (rows[second], rows[~second])
    return -sum(float((half.sum(axis=0) ** 2).sum()) / len(half) for half in halves)
