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
) -> tuple[int, float]:
    """Smooth the poses x = R b + t of a body, in place.

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

    Returns
    -------
    free
        Poses that are free: two for each path, as for a line, and those of paths that are too short for one.
    nats
        By how much less likely the paths are than lines, before the data are seen (Laplace).
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
    # A small turn changes the nine numbers by twice its square.
    nats = _smooth(centres, place, moving, dim, 1.0)
    nats += _smooth(turns, turn, moving, 3 if dim == 3 else 1, 0.5)
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
    return _free_poses(moving), nats


@compiled()
def _free_poses(moving: Bools) -> int:
    """Two for each run of frames that has a path, and those of shorter runs."""
    free, length = 0, 0
    for f in range(len(moving)):
        length = length + 1 if moving[f] else 0
        if 0 < length < _SHORTEST:
            free += 1
        elif length == _SHORTEST:
            free += 3 - _SHORTEST
    return free


@compiled()
def _smooth(z: Floats, weight: Floats, moving: Bools, channels: int, share: float) -> float:
    """Smooth the columns of z [F, C] in each run of moving frames, in place; nats as of :func:`smooth_poses`.

    They are so many independent channels, the squares of which are a share of those of the columns.
    """
    level, total = 0.0, 0
    for f in range(len(z)):
        if moving[f]:
            level, total = level + weight[f], total + 1
    if level <= 0.0:
        return 0.0
    path, best, band = z.copy(), z, np.zeros((len(z), 3))
    nats, least = 0.0, np.inf
    for stiffness in _STIFFNESS:
        cost, bent, stop = 0.0, 0.0, 0
        while stop < len(z):
            begin = stop
            while stop < len(z) and moving[stop]:
                stop += 1
            if stop - begin >= _SHORTEST:
                run = slice(begin, stop)
                pull = stiffness * level / total
                paid, more = _fit_path(z[run], weight[run], pull, channels, share, band[run], path[run])
                cost, bent = cost + paid, bent + more
            stop = max(stop, begin + 1)
        if cost < least:
            least, nats, best = cost, bent, path.copy()
    z[:] = best
    return nats


@compiled()
def _fit_path(
    z: Floats, weight: Floats, pull: float, channels: int, share: float, band: Floats, path: Floats
) -> tuple[float, float]:
    """The path of z [F, C] with the least weighted squares plus `pull` times those of second differences.

    Returns twice the negative log likelihood of the pull, but for what does not depend on it, and the nats
    of :func:`smooth_poses`: those of the second differences, and what the path is freer than a line. `band`
    [F, 3] is room for the factors of the equations: L D L^T, with two bands below the diagonal.
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
    left, s0, s1, s2 = 0.0, 0.0, 0.0, 0.0
    for f in range(n):
        for c in range(columns):
            path[f, c] += mean[c]
            left += weight[f] * (z[f, c] - path[f, c]) ** 2
        s0, s1, s2 = s0 + weight[f], s1 + weight[f] * f, s2 + weight[f] * f * f
    line = np.log(max(s0 * s2 - s1 * s1, 1e-300))
    return cost, 0.5 * (cost - share * left - channels * line)


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
