"""Compensates points for the motion that most of them have in common."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

_ITERATIONS = 6
# Fewest points that a rigid motion is fitted to.
_LEAST = 6
_TINY = 1e-6


def common_motion(start: Floats, end: Floats, usable: NDArray[np.bool_]) -> Floats:
    """Move points as most of them have moved: a rigid motion, by least squares with Cauchy weights.

    Parameters
    ----------
    start, end
        float64 [N, 3], NaN where unknown.
    usable
        bool [N], which points the motion may be fitted to.

    Returns
    -------
    float64 [N, 3]; `start` itself where too few points are known.
    """
    chosen = usable & np.isfinite(start).all(axis=1) & np.isfinite(end).all(axis=1)
    if chosen.sum() < _LEAST:
        return start
    source, target = start[chosen], end[chosen]
    turn, shift = Rotation.identity(), np.median(target - source, axis=0)
    for _ in range(_ITERATIONS):
        left = np.linalg.norm(turn.apply(source) + shift - target, axis=1)
        scale = max(float(np.median(left)), _TINY)
        weight = 1 / (1 + (left / scale) ** 2)
        middle, goal = (np.average(points, axis=0, weights=weight) for points in (source, target))
        turn, _ = Rotation.align_vectors(target - goal, source - middle, weights=weight)
        shift = goal - turn.apply(middle)
    return np.asarray(turn.apply(start) + shift)
