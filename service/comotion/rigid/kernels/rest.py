"""Compiled: in the poses of a body, out poses that are one for each rest of it."""

import numpy as np

from ...arrays import Bools, Floats
from ...compiled import compiled
from .procrustes import weighted_pose
from .records import PoseArrays

# Frames that a rest takes at least; at 15 Hz, half a second.
_LEAST_FRAMES = 8
# What one pose may cost beyond what poses of their own gain by fitting noise: so many standard deviations of
# that gain, and so many nats. Chosen on stress scenes of even seeds.
_DEVIATIONS, _NATS = 2.0, 6.0


@compiled()
def settle(
    w: Floats, inverse: Floats, b: Floats, dim: int, dof: int, poses: PoseArrays, rests: Bools
) -> None:
    """Give a body one pose in each run of frames in which it does not move beyond the noise, in place.

    From the newest frame backwards, a run grows as long as one pose for all of it is likely: twice the rise
    of the cost is chi-squared with `dof` degrees of freedom per frame.

    Parameters
    ----------
    w, inverse, b
        float64 [F, m] (0: unobserved), [m], inverse variance of the noise, and [3, m], template.
    dof
        Degrees of freedom of a pose.
    poses
        Those of each frame.
    rests
        Out: bool [F], whether the frame is one of a rest.
    """
    R, t, posed = poses
    count, m = w.shape
    sums, mean = np.zeros((4, m)), np.zeros((3, m))
    stop = count
    while stop > 0:
        begin, length = _run_before(w, inverse, b, dof, poses, stop)
        if length >= _LEAST_FRAMES:
            sums[:] = 0.0
            for f in range(begin, stop):
                if posed[f]:
                    _add_places(w[f], inverse, b, R[f], t[f], sums)
            for i in range(m):
                for c in range(3):
                    mean[c, i] = sums[c, i] / sums[3, i] if sums[3, i] > 0 else 0.0
            pose, shift = np.zeros((3, 3)), np.zeros(3)
            weighted_pose(mean, b, sums[3], dim, R[begin], pose, shift)
            for f in range(begin, stop):
                if posed[f]:
                    R[f], t[f], rests[f] = pose, shift, True
        stop = min(begin, stop - 1)


@compiled()
def _run_before(
    w: Floats, inverse: Floats, b: Floats, dof: int, poses: PoseArrays, stop: int
) -> tuple[int, int]:
    """First frame of the longest run of rest that ends before `stop`, and its number of posed frames."""
    R, t, posed = poses
    m = w.shape[1]
    # Sums of weights, of places relative to the first one, and of their squares.
    sums, first, place = np.zeros((5, m)), np.zeros((3, m)), np.zeros(3)
    begin, length = stop, 0
    for f in range(stop - 1, -1, -1):
        if not posed[f]:
            continue
        scatter = 0.0
        for i in range(m):
            a = w[f, i] * inverse[i]
            if a > 0:
                for c in range(3):
                    place[c] = R[f, c, 0] * b[0, i] + R[f, c, 1] * b[1, i] + R[f, c, 2] * b[2, i] + t[f, c]
                if sums[0, i] == 0:
                    first[:, i] = place
                sums[0, i] += a
                for c in range(3):
                    d = place[c] - first[c, i]
                    sums[1 + c, i] += a * d
                    sums[4, i] += a * d * d
            if sums[0, i] > 0:
                squared = sums[1, i] ** 2 + sums[2, i] ** 2 + sums[3, i] ** 2
                scatter += max(sums[4, i] - squared / sums[0, i], 0.0)
        expected = 0.5 * dof * length
        if 0.5 * scatter > expected + _DEVIATIONS * np.sqrt(expected) + _NATS:
            break
        begin, length = f, length + 1
    return begin, length


@compiled()
def _add_places(w: Floats, inverse: Floats, b: Floats, R: Floats, t: Floats, sums: Floats) -> None:
    """Add weighted places of the template's points in a frame to [4, m], the weights last, in place."""
    for i in range(len(w)):
        a = w[i] * inverse[i]
        for c in range(3):
            sums[c, i] += a * (R[c, 0] * b[0, i] + R[c, 1] * b[1, i] + R[c, 2] * b[2, i] + t[c])
        sums[3, i] += a
