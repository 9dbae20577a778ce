"""Label propagation: new clusters take up the hypotheses they share most trajectories with."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..partition import NO_HYPOTHESIS

Labels = NDArray[np.int64]


def propagate(before: Labels, clusters: NDArray[np.intp], allocate: Callable[[], int]) -> Labels:
    """Hypothesis ids for clusters.

    M counts the trajectories that an old hypothesis and a new cluster share. The largest entry makes
    a match and strikes its row and column, until the largest is 0. Ties go to the older hypothesis,
    then to the first cluster. A cluster that is left over is a new hypothesis.

    Parameters
    ----------
    before
        int64 [n], hypothesis of each trajectory until now, :data:`NO_HYPOTHESIS` for a newborn.
    clusters
        intp [n], 0 to K - 1.
    allocate
        Gives a fresh id.

    Returns
    -------
    NDArray[int64]
        [n], hypothesis of each trajectory.
    """
    known = before != NO_HYPOTHESIS
    old, row = np.unique(before[known], return_inverse=True)
    count = int(clusters.max(initial=-1)) + 1
    shared = np.bincount(row * count + clusters[known], minlength=len(old) * count).reshape(len(old), count)
    ids = np.full(count, NO_HYPOTHESIS)
    while shared.any():
        k, m = np.unravel_index(int(shared.argmax()), shared.shape)
        ids[m] = old[k]
        shared[k], shared[:, m] = 0, 0
    for m in np.flatnonzero(ids == NO_HYPOTHESIS):
        ids[m] = allocate()
    return ids[clusters]


def follow(before: Labels, now: Labels, dormant: Labels) -> Labels:
    """Labels of outdated trajectories, after the current ones went from `before` to `now`.

    They keep their label: it waits for their return. Only where a hypothesis has no current member
    left, and more of its members have just gone over to another than are waiting, they go with them.

    Parameters
    ----------
    before, now
        int64 [n], of the current trajectories.
    dormant
        int64 [m], of the outdated ones.
    """
    followed = dormant.copy()
    for label in np.unique(dormant):
        if (now == label).any():
            continue
        went, votes = np.unique(now[before == label], return_counts=True)
        waiting = dormant == label
        if label != NO_HYPOTHESIS and votes.max(initial=0) > waiting.sum():
            followed[waiting] = went[votes.argmax()]
    return followed
