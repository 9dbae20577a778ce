"""Sides of boxes: the outermost points that are not far from all others, as a wrong member is."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Floats
from ..compiled import compiled

FAR = 8.0
"""Times the usual distance to the second neighbour from which on a point is far from all others."""


def apart_of(points: Floats) -> Floats:
    """Distance of points [m, dim] to the second neighbour, if there are as many, float64 [m]."""
    apart, _ = cKDTree(points).query(points, k=[min(3, len(points))])
    return np.asarray(apart[:, 0])


@compiled()
def sides_of(along: Floats, far: float) -> tuple[Floats, Floats]:
    """Least and largest coordinates [dim] of points [m, dim] that are not as far from all others.

    Of all, where more than half are: then the body has other points than those that `far` was measured on.
    """
    count, dim = along.shape
    ends, neighbours = np.zeros(2 * dim, np.intp), np.zeros(2 * dim, np.intp)
    kept = np.ones(count, np.bool_)
    while 2 * kept.sum() >= count:
        rows, neighbours[:] = np.flatnonzero(kept), 0
        for k in range(dim):
            ends[k], ends[dim + k] = rows[along[rows, k].argmin()], rows[along[rows, k].argmax()]
        for j in range(2 * dim):
            for m in rows:
                square = 0.0
                for k in range(dim):
                    square += (along[ends[j], k] - along[m, k]) ** 2
                neighbours[j] += square <= far**2
        alone = neighbours <= min(2, len(rows) - 1)
        if not alone.any():
            low, high = ends[:dim], ends[dim:]
            return np.diag(along[low]).copy(), np.diag(along[high]).copy()
        kept[ends[alone]] = False
    every = np.arange(dim)
    return np.array([along[:, k].min() for k in every]), np.array([along[:, k].max() for k in every])
