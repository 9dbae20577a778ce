"""Boxes of hypotheses: the extent of the members ever seen.

A point of a body is kept in the axes of the body, b = R^T (x - t) with its pose since birth. A point whose
feature is seen moves with it; one whose feature was a member for long enough when it was lost remains. Points
far from all others do not count: a wrong member would stretch the box for ever. Where no pose is known there
is nothing to keep points in: the box is upright, and its sides follow the current members.
"""

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from comotion_schemas import Box

from ..arrays import Floats, Ints, median
from ..geometry.rotation import quaternion
from .records import FAR, Record, apart_of, sides_of

# Points of lost features of one hypothesis; of more, those remain that are farthest in some direction.
_MAX_POINTS = 256
# A box replaces the last one if its size is below this share of it, so that axes do not jump.
_SMALLER = 0.9
# ns; the axes of a box are sought so often, as the search costs more than the rest of this module.
_SEEK_NS = 1_000_000_000
# rad; step of the search for the smallest box.
_STEP = np.pi / 60


def box_of(record: Record, *, seek: bool = True) -> Box:
    """Box of a hypothesis that is seen, in the axes of the space.

    Its record gets the axes, and loses points that tell nothing. To `seek` axes takes most of the time.
    """
    if not record.posed:
        low, high = record.sides
        upright = 0.0 if len(low) == 2 else [0.0, 0.0, 0.0, 1.0]
        return Box.trusted(
            center=((low + high) / 2).tolist(), half=((high - low) / 2).tolist(), rotation=upright
        )
    points, (R, t) = _points(record), record.pose
    axes = np.eye(len(t)) if record.axes is None else record.axes
    due = seek and record.seen_ns >= record.sought_ns + _SEEK_NS
    if due or not record.spacing:
        apart = apart_of(points)
        record.spacing = float(median(apart))
    if due:
        near = points[apart <= FAR * record.spacing]
        axes, record.sought_ns = _best_axes(near, axes), record.seen_ns
    record.axes = axes
    low, high = sides_of(points @ axes, FAR * record.spacing)
    turn = R @ axes
    center = turn @ ((low + high) / 2) + t
    rotation = float(np.arctan2(turn[1, 0], turn[0, 0])) if len(t) == 2 else quaternion(turn).tolist()
    return Box.trusted(center=center.tolist(), half=((high - low) / 2).tolist(), rotation=rotation)


def _points(record: Record) -> Floats:
    """Points of the body, float64 [m, dim] in its axes: its members, and those that were lost."""
    lost = record.lost.lasted.nonzero()[0]
    points = record.lost.points
    if len(lost) > _MAX_POINTS:
        apart = apart_of(points[lost])
        near = lost[apart <= FAR * median(apart)]
        far = near[_farthest(points[near])]
        rows = np.isin(np.arange(len(points)), np.setdiff1d(lost, far), invert=True)
        record.lost = record.lost.of(rows)
        lost = far
    shown = record.members.shown
    return np.concatenate([shown, points[lost]]) if len(lost) else shown


_ALL_AROUND = {dim: np.array(list(product(range(-2, 3), repeat=dim)), np.float64).T for dim in (2, 3)}


def _farthest(points: Floats) -> Ints:
    """Rows that are farthest in some direction, ascending."""
    return np.unique((points @ _ALL_AROUND[points.shape[1]]).argmax(0))


def _best_axes(points: Floats, last: Floats) -> Floats:
    """Axes of a small box around points [m, dim], as columns; the last ones if they are as good.

    The candidates share an axis with the principal axes of the points. The size of a box is half its
    surface, in 2-D half its outline, which distinguish flat boxes.
    """
    if len(points) > 2 * _MAX_POINTS:
        points = points[_farthest(points)]
    centred = points - points.mean(0)
    principal = np.linalg.eigh(centred.T @ centred)[1][:, ::-1]
    turns = _TURNS[points.shape[1]]
    sizes = _sizes(points @ principal, turns)
    best = int(sizes.argmin())
    if sizes[best] >= _SMALLER * _sizes(points, last[None])[0]:
        return last
    # In the order and with the signs that turn them least from the last ones; right-handed.
    axes = principal @ turns[best]
    alike = (axes * np.append(np.ones(len(axes) - 1), np.linalg.det(axes))) @ _SAME_BOX[len(axes)]
    return np.asarray(alike[(alike * last).sum((1, 2)).argmax()])


# Rotations about each axis, float64 [n, dim, dim] by dim; all boxes are met within a right angle.
_ANGLES = np.arange(0, np.pi / 2, _STEP)
_TURNS = {3: np.concatenate([Rotation.from_rotvec(np.outer(_ANGLES, u)).as_matrix() for u in np.eye(3)])}
_TURNS[2] = _TURNS[3][-len(_ANGLES) :, :2, :2]
# Rotations that exchange axes of a box.
_SAME_BOX = {3: np.round(Rotation.create_group("O").as_matrix())}
_SAME_BOX[2] = np.array([turn[:2, :2] for turn in _SAME_BOX[3] if turn[2, 2] > 0])


def _sizes(points: Floats, axes: Floats) -> Floats:
    """Half the surface (in 2-D the outline) of the boxes with axes [n, dim, dim], [n]."""
    dim = points.shape[1]
    along = points @ axes.transpose(1, 0, 2).reshape(dim, -1)
    a = (along.max(0) - along.min(0)).reshape(-1, dim)
    size = a.sum(1) if dim == 2 else a[:, 0] * a[:, 1] + a[:, 1] * a[:, 2] + a[:, 0] * a[:, 2]
    return np.asarray(size)
