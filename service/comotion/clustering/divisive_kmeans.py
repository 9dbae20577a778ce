"""Divisive k-means (3.6): halve the affinity graph while a cluster holds a weak edge."""

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from ..window import Floats


def divisive_kmeans(affinity: Floats, stop_affinity: float) -> NDArray[np.intp]:
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
            second = _halve(rows)
            pending += [members[second], members[~second]]
        else:
            labels[members] = found
            found += 1
    return labels


def _halve(rows: Floats) -> NDArray[np.bool_]:
    """2-means on rows [n, n], not all equal; bool [n].

    The two rows that are least alike start the halves: they have to part, and the outcome does not
    hang on chance.
    """
    apart = np.unravel_index(int(rows.argmin()), rows.shape)
    fitted = KMeans(2, init=rows[list(apart)], n_init=1).fit(rows)
    halves: NDArray[np.bool_] = fitted.labels_ == 1
    return halves
