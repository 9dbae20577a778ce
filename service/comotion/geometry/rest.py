"""Compiled: finds the rests of a body and gives each one pose."""

import numpy as np

from ..arrays import Bools, Floats
from ..compiled import compiled
from .frame_pose import frame_pose
from .records import PoseArrays, quadratic

FALSE_ALARMS = 20.0
"""Tests against noise per false alarm."""


@compiled()
def settle(
    w: Floats,
    inverse: Floats,
    metric: Floats,
    b: Floats,
    dim: int,
    dof: int,
    least: float,
    poses: PoseArrays,
    rests: Bools,
) -> int:
    """Give a body one pose in each run of frames in which it does not move beyond the noise, in place.

    From the newest frame backwards, a run grows as long as one pose for all of it is likely: twice the rise
    of the cost is chi-squared with `dof` degrees of freedom per frame, by which poses in every frame gain.

    Parameters
    ----------
    w, inverse, metric, b
        float64 [F, m] (0: unobserved), [m], inverse variance of the noise, [m, 6], its metric, and [3, m],
        template.
    dof, least
        Degrees of freedom of a pose, and frames that a rest takes at least.
    poses
        Those of each frame.
    rests
        Out: bool [F], whether the frame is one of a rest.

    Returns
    -------
    The number of rests.
    """
    R, t, posed = poses
    count, m = w.shape
    places, mean, weights = np.zeros((count, 3, m)), np.zeros((3, m)), np.zeros((count, m))
    for f in range(count):
        if posed[f]:
            weights[f] = w[f] * inverse
            for c in range(3):
                for i in range(m):
                    places[f, c, i] = (
                        R[f, c, 0] * b[0, i] + R[f, c, 1] * b[1, i] + R[f, c, 2] * b[2, i] + t[f, c]
                    )
    stop, runs = count, 0
    while stop > 0:
        begin, length = _run_before(places, weights, metric, dof, posed, stop)
        if length >= least:
            total = weights[begin:stop].sum(0)
            for c in range(3):
                mean[c] = (weights[begin:stop] * places[begin:stop, c]).sum(0) / np.maximum(total, 1e-300)
            pose, shift = np.zeros((3, 3)), np.zeros(3)
            runs += 1
            frame_pose(mean, b, total, dim, R[begin], R[begin], True, pose, shift)
            for f in range(begin, stop):
                if posed[f]:
                    R[f], t[f], rests[f] = pose, shift, True
        stop = min(begin, stop - 1)
    return runs


@compiled()
def _run_before(
    places: Floats, weights: Floats, metric: Floats, dof: int, posed: Bools, stop: int
) -> tuple[int, int]:
    """First frame of the longest run of rest that ends before `stop`, and its number of posed frames."""
    m = weights.shape[1]
    # Sums of weights, of places relative to the first one, and of their squares.
    sums, first = np.zeros((5, m)), np.zeros((3, m))
    begin, length, rare = stop, 0, np.log(FALSE_ALARMS)
    for f in range(stop - 1, -1, -1):
        if not posed[f]:
            continue
        scatter = 0.0
        for i in range(m):
            a = weights[f, i]
            if a > 0:
                if sums[0, i] == 0:
                    first[:, i] = places[f, :, i]
                d0, d1 = places[f, 0, i] - first[0, i], places[f, 1, i] - first[1, i]
                d2 = places[f, 2, i] - first[2, i]
                sums[0, i] += a
                sums[1, i] += a * d0
                sums[2, i] += a * d1
                sums[3, i] += a * d2
                sums[4, i] += a * quadratic(metric[i], d0, d1, d2)
            if sums[0, i] > 0:
                squared = quadratic(metric[i], sums[1, i], sums[2, i], sums[3, i])
                scatter += max(sums[4, i] - squared / sums[0, i], 0.0)
        freedom = 1.0 * dof * length
        # The bound of the tail of chi-squared is that of Laurent and Massart (2000).
        if scatter > freedom + 2 * np.sqrt(freedom * rare) + 2 * rare:
            break
        begin, length = f, length + 1
    return begin, length
