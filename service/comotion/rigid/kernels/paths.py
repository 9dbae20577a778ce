"""Compiled: in the poses of a body, out the same on a smooth path."""

import numpy as np

from ...arrays import Bools, Floats
from ...compiled import compiled
from .records import PoseArrays
from .rotation import planar_rotation, spatial_rotation

# Variances of the noise of a pose over those of the accelerations of its body that are compared, per frame.
# A hundredfold one smooths over three times as many frames: from over none, as people move before a camera
# without noise, to over a window.
_STIFFNESS = (1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6, 1e8)
# Frames without a rest, at least, that have a path: fewer are a line.
_SHORTEST = 4


@compiled()
def smooth_poses(
    middle: Floats, place: Floats, turn: Floats, moving: Bools, dim: int, poses: PoseArrays
) -> float:
    """Smooth the poses x = R b + t of a body, in place; returns the number of poses that are as free.

    The body is accelerated at random: its path is the most probable one, for the accelerations under which
    its poses are most likely. These are sought apart for the middle and for the rotation.

    Parameters
    ----------
    middle
        float64 [3], body coordinates of the middle of the points that hold the poses.
    place, turn
        float64 [F], inverse variances of a coordinate of the middle and of an angle, in each frame.
    moving
        bool [F], frames with a pose of their own. What lies on both sides of others has paths of its own.
    """
    R, t, _ = poses
    count = len(t)
    centres, turns = np.zeros((count, 3)), np.zeros((count, 9))
    for f in range(count):
        for c in range(3):
            centres[f, c] = t[f, c]
            for d in range(3):
                centres[f, c] += R[f, c, d] * middle[d]
                turns[f, 3 * c + d] = R[f, c, d]
    angles = 3 if dim == 3 else 1
    # A small turn changes the nine numbers by twice its square.
    free = dim * _smooth(centres, place, moving, dim, 1.0)
    free += angles * _smooth(turns, turn, moving, angles, 0.5)
    for f in range(count):
        if moving[f]:
            if dim == 3:
                spatial_rotation(turns[f].reshape(3, 3), R[f].copy(), True, R[f])
            else:
                planar_rotation(turns[f].reshape(3, 3), R[f])
            for c in range(3):
                t[f, c] = centres[f, c]
                for d in range(3):
                    t[f, c] -= R[f, c, d] * middle[d]
    return free / (dim + angles)


@compiled()
def _smooth(z: Floats, weight: Floats, moving: Bools, channels: int, share: float) -> float:
    """Smooth the columns of z [F, C] in each run of moving frames, in place; how many frames are as free.

    They are so many independent channels, the squares of which are a share of those of the columns.
    """
    level, total = 0.0, 0
    for f in range(len(z)):
        if moving[f]:
            level, total = level + weight[f], total + 1
    if level <= 0.0:
        return float(total)
    path, best, band = z.copy(), z, np.zeros((len(z), 3))
    free, least = float(total), np.inf
    for stiffness in _STIFFNESS:
        cost, used, stop = 0.0, 0.0, 0
        while stop < len(z):
            begin = stop
            while stop < len(z) and moving[stop]:
                stop += 1
            if stop - begin >= _SHORTEST:
                run = slice(begin, stop)
                pull = stiffness * level / total
                paid, held = _fit_path(z[run], weight[run], pull, channels, share, band[run], path[run])
                cost, used = cost + paid, used + held
            else:
                used += stop - begin
            stop = max(stop, begin + 1)
        if cost < least:
            least, free, best = cost, used, path.copy()
    z[:] = best
    return free


@compiled()
def _fit_path(
    z: Floats, weight: Floats, pull: float, channels: int, share: float, band: Floats, path: Floats
) -> tuple[float, float]:
    """The path of z [F, C] with the least weighted squares plus `pull` times those of second differences.

    Returns twice the negative log likelihood of the pull, but for what does not depend on it, and the trace
    of the smoother. `band` [F, 3] is room for the factors of the equations: L D L^T, with two bands below
    the diagonal.
    """
    n, columns = z.shape
    _factor(weight, pull, band)
    mean = np.zeros(columns)
    for f in range(n):
        for c in range(columns):
            mean[c] += z[f, c] / n
    # Frame by frame, as the columns of a frame do not wait for one another.
    for f in range(n):
        before, earlier = max(f - 1, 0), max(f - 2, 0)
        one, two = (band[before, 1] if f > 0 else 0.0), (band[earlier, 2] if f > 1 else 0.0)
        for c in range(columns):
            path[f, c] = weight[f] * (z[f, c] - mean[c]) - one * path[before, c] - two * path[earlier, c]
    cost = -channels * (n - 2) * np.log(pull)
    for f in range(n - 1, -1, -1):
        after, later, inverse = min(f + 1, n - 1), min(f + 2, n - 1), 1.0 / band[f, 0]
        one, two, squares = band[f, 1], band[f, 2], 0.0
        for c in range(columns):
            path[f, c] = path[f, c] * inverse - one * path[after, c] - two * path[later, c]
            squares += (z[f, c] - mean[c]) * (z[f, c] - mean[c] - path[f, c])
        cost += channels * np.log(band[f, 0]) + share * weight[f] * squares
    for f in range(n):
        for c in range(columns):
            path[f, c] += mean[c]
    return cost, _trace(weight, band)


@compiled()
def _factor(weight: Floats, pull: float, band: Floats) -> None:
    """Factors of diag(weight) + pull D^T D, D second differences: D and the two bands of L, to [F, 3]."""
    n = len(weight)
    for f in range(n):
        # How often a frame, and it and its next, are in a second difference, with what weights.
        diagonal = (f < n - 2) + 4.0 * (0 < f < n - 1) + (f > 1)
        beside = -2.0 * ((f < n - 2) + (0 < f < n - 1))
        d, one = weight[f] + pull * diagonal, pull * beside
        if f > 0:
            d -= band[f - 1, 1] ** 2 * band[f - 1, 0]
            one -= band[f - 1, 1] * band[f - 1, 0] * band[f - 1, 2]
        if f > 1:
            d -= band[f - 2, 2] ** 2 * band[f - 2, 0]
        band[f, 0] = d
        band[f, 1] = one / d if f < n - 1 else 0.0
        band[f, 2] = pull / d if f < n - 2 else 0.0


@compiled()
def _trace(weight: Floats, band: Floats) -> float:
    """Sum of the weights times the diagonal of the inverse (Hutchinson and de Hoog 1985)."""
    total, s00, s01, s11 = 0.0, 0.0, 0.0, 0.0
    # The inverse at (f, f), (f, f + 1) and (f + 1, f + 1), from the last frame on.
    for f in range(len(weight) - 1, -1, -1):
        one, two = band[f, 1], band[f, 2]
        beside = -one * s00 - two * s01
        across = -one * s01 - two * s11
        own = 1.0 / band[f, 0] - one * beside - two * across
        total += weight[f] * own
        s00, s01, s11 = own, beside, s00
    return total
