"""Compiled: in costs or poses, out what members lose if a body is closed, and where it has carried them."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled
from .records import PoseArrays, RowArrays


@compiled()
def closing_losses(outlier: Floats, body: Floats, chosen: Ints) -> Floats:
    """Cost that closing each of the open bodies would add, without the price that it saves.

    Parameters
    ----------
    outlier, body
        float64 [N] and [N, K], cost of each trajectory as an outlier and under each body.
    chosen
        intp [n], columns of the open bodies.

    Returns
    -------
    float64 [n].
    """
    found = np.zeros(len(chosen))
    for i in range(len(outlier)):
        best, lowest, second = -1, outlier[i], np.inf
        for k in range(len(chosen)):
            cost = body[i, chosen[k]]
            if cost < lowest:
                best, lowest, second = k, cost, lowest
            elif cost < second:
                second = cost
        if best >= 0:
            found[best] += second - lowest
    return found


@compiled()
def carry(arrays: RowArrays, rows: Ints, tracks: Ints, poses: PoseArrays, position: Floats) -> None:
    """Move each trajectory along with its body, from where it was last seen to the newest pose, in place.

    Parameters
    ----------
    rows, tracks
        intp [n], a row of each trajectory, and the trajectory.
    poses
        Poses of the body, at least one.
    position
        Out: float64 [N, 3], of which the entries `tracks` are written.
    """
    y, w, _, _, _ = arrays
    R, t, posed = poses
    now = len(posed) - 1
    while not posed[now]:
        now -= 1
    for n in range(len(rows)):
        i, last = rows[n], len(posed) - 1
        while last >= 0 and not (posed[last] and w[i, last] > 0):
            last -= 1
        if last < 0:
            continue
        for c in range(3):
            position[tracks[n], c] = t[now, c]
        for d in range(3):
            inside = 0.0
            for c in range(3):
                inside += R[last, c, d] * (y[i, last, c] - t[last, c])
            for c in range(3):
                position[tracks[n], c] += R[now, c, d] * inside
