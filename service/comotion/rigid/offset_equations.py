"""Normal equations of the rotation, shift and delay of a source, from its rows and a body's poses."""

from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..geometry.body import Body, pose_columns
from ..geometry.frames import FEWEST, Frames
from ..geometry.rotation import ROUNDING

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

    def after(self, step: Floats) -> float:
        """Squared residual after a step."""
        return float(self.squared - 2 * step @ self.right + step @ self.left @ step)


def normal_equations(
    frames: Frames, rows: Ints, y: Floats, w: Floats, body: Body, information: Floats, pivot: Floats
) -> Equations:
    """Equations of rows that should be constant in the frame of one body.

    z = R^T (y - t) has the derivative R^T [omega x (y - pivot) + shift + velocity delay]. The place of a row
    in the body is unknown, so only departures from its mean count. The errors of the poses are common to the
    rows: they are unknowns of each frame, and eliminated (Schur complement).

    Parameters
    ----------
    rows, y, w
        intp [n]; float64 [n, F, 3] and [n, F], where they are and their weights (0: unobserved).
    information
        float64 [F, 6, 6], of :func:`~comotion.geometry.body.pose_information`.
    pivot
        float64 [3], centre of the rotation.
    """
    velocity = velocities(y, w > 0, frames.step)
    seen = (w > 0) & body.posed & np.isfinite(velocity[..., 0])
    enough = seen.sum(1) >= FEWEST
    y, seen, scale = y[enough], seen[enough], np.sqrt(1 / frames.tolerance[rows[enough]])[:, None, None]
    turns = pose_columns((y - pivot).reshape(-1, 3), 3).reshape(*seen.shape, 3, 6)
    # The last column is the residual.
    others = np.stack([np.nan_to_num(velocity[enough]), y - body.t], -1)
    design = body.R.transpose(0, 2, 1) @ np.concatenate([turns, others], -1) * seen[..., None, None]
    design[:, :, frames.dim :] = 0.0
    mean = design.sum(1) / np.maximum(seen.sum(1), 1)[:, None, None]
    design = scale[..., None] * (design - seen[..., None, None] * mean[:, None])
    flat = design.reshape(-1, UNKNOWNS + 1)
    J = pose_columns(mean[..., UNKNOWNS], frames.dim) * scale
    added = (seen.T @ (J.transpose(0, 2, 1) @ J).reshape(-1, 36)).reshape(-1, 6, 6)
    cross = np.tensordot(design, J, ((0, 2), (0, 1))).transpose(0, 2, 1)
    any_seen = seen.any(0)
    taken, fewer = _eliminated(information[any_seen], added[any_seen], cross[any_seen])
    whole = flat.T @ flat - taken
    left, right = whole[:UNKNOWNS, :UNKNOWNS], -whole[:UNKNOWNS, UNKNOWNS]
    coordinates = float(frames.dim * seen.sum()) - fewer
    return Equations(left, right, float(whole[UNKNOWNS, UNKNOWNS]), coordinates)


def velocities(y: Floats, seen: Bools, step: float) -> Floats:
    """Velocity of rows [n, F, 3] where they are seen, bool [n, F], and on both sides; NaN elsewhere."""
    return np.asarray(np.gradient(np.where(seen[..., None], y, np.nan), step, axis=1), np.float64)


def _eliminated(information: Floats, added: Floats, cross: Floats) -> tuple[Floats, float]:
    """Part of the equations, float64 [8, 8], and of the coordinates that errors of poses [F, 6] absorb."""
    pose = information + added
    # Where the information of a pose is singular.
    ridge = ROUNDING * np.trace(pose, axis1=1, axis2=2) / 6
    regular = pose + ridge[:, None, None] * np.eye(6)
    solved = np.linalg.solve(regular, np.concatenate([cross, added], 2))
    taken = np.tensordot(cross, solved[:, :, : UNKNOWNS + 1], ((0, 1), (0, 1)))
    return taken, float(np.trace(solved[:, :, UNKNOWNS + 1 :], axis1=1, axis2=2).sum())
