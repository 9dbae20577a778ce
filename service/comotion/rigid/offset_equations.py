"""Normal equations of the rotation, shift and delay of a source, from its rows and a body's poses."""

from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats, Ints
from .kernels.records import RowArrays
from .kernels.rotation import ROUNDING
from .procrustes import Body, pose_columns

UNKNOWNS = 7
"""Rotation vector, shift and delay."""


class Equations(NamedTuple):
    """Normal equations `left` x = `right` of a step x, the squared residual before it, and the coordinates.

    The residual is in units of the rows' variances; the coordinates are those that it is the sum of, less
    those that the poses take up.
    """

    left: Floats
    right: Floats
    squared: float
    coordinates: float


def normal_equations(
    arrays: RowArrays,
    seconds: Floats,
    rows: Ints,
    body: Body,
    information: Floats,
    pivot: Floats,
    dim: int,
    least: int,
) -> Equations:
    """Equations of rows intp [n] that should be constant in the frame of one body.

    z = R^T (y - t) has the derivative R^T [omega x (y - pivot) + shift + velocity delay]. The place of a row
    in the body is unknown, so only departures from its mean count. The errors of the poses are common to the
    rows: they are unknowns of each frame, and eliminated (Schur complement).

    Parameters
    ----------
    seconds
        float64 [F], times of the frames.
    information
        float64 [F, 6, 6], of :func:`~.procrustes.pose_information`.
    pivot
        float64 [3], centre of the rotation.
    dim, least
        2 or 3; rows with fewer frames are left out.
    """
    seen = (arrays.w[rows] > 0) & body.posed
    enough = seen.sum(1) >= least
    rows, seen = rows[enough], seen[enough]
    y, inverse = arrays.y[rows], 1 / arrays.tolerance[rows]
    # The last column is the residual.
    design = np.zeros((*seen.shape, 3, UNKNOWNS + 1))
    inward = body.R.transpose(0, 2, 1)
    design[..., :3] = np.cross((y - pivot)[:, :, None], inward)
    design[..., 3:6] = inward
    moving = velocities(y, seen, seconds), y - body.t
    design[..., 6:] = np.einsum("fij,knfj->nfik", inward, np.stack(moving))
    design *= seen[..., None, None]
    mean = design.sum(1) / np.maximum(seen.sum(1), 1)[:, None, None]
    design -= seen[..., None, None] * mean[:, None]
    flat = (np.sqrt(inverse)[:, None, None, None] * design).reshape(-1, UNKNOWNS + 1)
    whole = flat.T @ flat
    J = pose_columns(mean[..., UNKNOWNS], dim) * np.sqrt(inverse)[:, None, None]
    pose = seen.T @ (J.transpose(0, 2, 1) @ J).reshape(len(rows), J.shape[2] ** 2)
    by_frame = flat.reshape(*seen.shape, 3, UNKNOWNS + 1).transpose(1, 0, 2, 3)
    cross = J.reshape(-1, 6).T @ by_frame.reshape(len(seconds), 3 * len(rows), UNKNOWNS + 1)
    coordinates = float(dim * seen.sum())
    any_seen = seen.any(0)
    taken, fewer = _eliminated(information[any_seen], pose.reshape(-1, 6, 6)[any_seen], cross[any_seen])
    whole -= taken
    left, right = whole[:UNKNOWNS, :UNKNOWNS], -whole[:UNKNOWNS, UNKNOWNS]
    return Equations(left, right, float(whole[UNKNOWNS, UNKNOWNS]), coordinates - fewer)


def velocities(y: Floats, seen: Bools, seconds: Floats) -> Floats:
    """Velocity of rows [n, F, 3] at the frames in which they are seen, bool [n, F]; zero elsewhere.

    By a difference of second order where there are frames on both sides, else of first order.
    """
    frame, row = np.arange(len(seconds)), np.arange(len(y))[:, None]
    low, high = np.tile(frame, (2, *seen.shape[:1], 1))
    low[:, 1:] = np.maximum.accumulate(np.where(seen, frame, -1), 1)[:, :-1]
    high[:, :-1] = np.minimum.accumulate(np.where(seen, frame, len(frame))[:, ::-1], 1)[:, -2::-1]
    low, high = np.where(low < 0, frame, low), np.where(high == len(frame), frame, high)
    before, after = seconds - seconds[low], seconds[high] - seconds
    # The slope on the nearer side counts more; there is none where nothing is seen on that side.
    earlier, later = (
        np.where(after > 0, after, 1.0) * (before > 0),
        np.where(before > 0, before, 1.0) * (after > 0),
    )
    earlier, later = (side * seen / np.maximum(earlier + later, 1e-300) for side in (earlier, later))
    rise = (earlier / np.maximum(before, 1e-300))[..., None] * (y - y[row, low])
    return np.asarray(rise + (later / np.maximum(after, 1e-300))[..., None] * (y[row, high] - y))


def _eliminated(information: Floats, added: Floats, cross: Floats) -> tuple[Floats, float]:
    """Part of the equations, float64 [8, 8], and of the coordinates that errors of poses [F, 6] absorb."""
    pose = information + added
    # Where the information of a pose is singular.
    ridge = ROUNDING * np.trace(pose, axis1=1, axis2=2) / pose.shape[1]
    regular = pose + ridge[:, None, None] * np.eye(pose.shape[1])
    solved = np.linalg.solve(regular, np.concatenate([cross, added], 2))
    columns = cross.shape[2]
    taken = np.einsum("fpq,fpr->qr", cross, solved[:, :, :columns])
    return taken, float(np.trace(solved[:, :, columns:], axis1=1, axis2=2).sum())
