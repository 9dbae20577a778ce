"""Boxes of hypotheses: the extent of the members ever seen.

A point of a body is kept in the axes of the body, b = R^T (x - t) with its pose since birth. A point whose
feature is seen moves with it; one whose feature was a member for long enough when it was lost remains. Where
no pose is known there is nothing to keep points in: the box is that of the current members without those far
from all others, of which one alone would stretch it across an image.
"""

from itertools import product

import numpy as np
from scipy.optimize import linear_sum_assignment

from comotion_schemas import Box

from ..arrays import Bools, Floats, Stamps, find
from ..partition import PoseReference
from ..rigid.kernels.rotation import quaternion
from .records import Current, Extent

# s; a feature that was a member for less, or that another hypothesis has now, says nothing about the body.
_LASTING = 0.5
# Points of lost features of one hypothesis; of more, those remain that are farthest in some direction.
_MAX_POINTS = 256
# A box replaces the last one if its size is below this share of it, so that axes do not jump.
_SMALLER = 0.9
# ns; the axes of a box are sought so often, as the search costs more than the rest of this module.
_SEEK_NS = 500_000_000
# rad; step of the search for the smallest box.
_STEP = np.pi / 60
# Without a pose: share of the members that may lie far from the others on each side, and how far beyond the
# others a member counts, in their extent.
_FAR_SHARE, _BEYOND = 0.1, 2.0
# Fewer members have no far ones.
_MIN_TOGETHER = 5


def measured(
    before: Extent | None,
    stamp_ns: int,
    one: int,
    current: Current,
    reference: PoseReference | None,
    *,
    seek: bool = True,
) -> tuple[Extent, Box]:
    """What is known of the extent of a hypothesis with current members, and its box.

    Parameters
    ----------
    before
        What was known; None for nothing.
    stamp_ns
        The watermark.
    one
        The hypothesis.
    current
        The current trajectories.
    reference
        Its pose; None where none is known.
    seek
        Whether the axes of the box may be sought, which takes most of the time.
    """
    dim = current.positions.shape[1]
    R, t = np.eye(dim), np.zeros(dim)
    if reference is not None:
        R, t = reference.R[:dim, :dim], reference.t[:dim]
    elif before is not None:
        before = before.without_points()
    mine = current.members[one]
    if current.sure[mine].any():
        mine = mine[current.sure[mine]]
    if reference is None:
        mine = mine[_together(current.positions[mine])]
    keys, points, since = current.keys[mine], (current.positions[mine] - t) @ R, np.full(len(mine), stamp_ns)
    axes, sought_ns = np.eye(dim), stamp_ns - _SEEK_NS
    if before is not None:
        axes, sought_ns = before.axes, before.sought_ns
    if before is not None and np.array_equal(keys, before.keys):
        since = before.since
    elif before is not None:
        at = find(keys, before.keys)
        since[at >= 0] = before.since[at[at >= 0]]
        lost = _lost(stamp_ns, before, current.keys)
        keys = np.concatenate([keys, before.keys[lost]])
        points = np.concatenate([points, before.points[lost]])
        since = np.concatenate([since, before.since[lost]])
        order = np.argsort(keys)
        keys, points, since = keys[order], points[order], since[order]
    if seek and stamp_ns >= sought_ns + _SEEK_NS:
        axes, sought_ns = best_axes(points, axes), stamp_ns
    extent = Extent(keys, points, since, axes, sought_ns)
    return extent, _box(extent, R, t)


def _together(points: Floats) -> Bools:
    """Which points [m, dim] are not far from the others along any axis, bool [m]."""
    if len(points) < _MIN_TOGETHER:
        return np.ones(len(points), np.bool_)
    far = max(round(_FAR_SHARE * len(points)), 1)
    ranked = np.sort(points, axis=0)
    low, high = ranked[far], ranked[-1 - far]
    slack = _BEYOND * (high - low).max()
    return np.asarray(((points >= low - slack) & (points <= high + slack)).all(axis=1))


def _lost(stamp_ns: int, extent: Extent, current: Stamps) -> Stamps:
    """Rows of features that are not seen any more and were members for long enough, bounded in number."""
    gone = find(extent.keys, current) < 0
    lost = np.flatnonzero(gone & (extent.since <= stamp_ns - int(_LASTING * 1e9)))
    if len(lost) > _MAX_POINTS:
        lost = lost[_farthest(extent.points[lost])]
    return lost


def _directions(dim: int) -> Floats:
    """Unit vectors [dim, n] all around."""
    grid = np.array([v for v in product(range(-2, 3), repeat=dim) if any(v)], np.float64)
    return np.asarray(np.unique(grid / np.linalg.norm(grid, axis=1)[:, None], axis=0).T)


_ALL_AROUND = {dim: _directions(dim) for dim in (2, 3)}


def _farthest(points: Floats) -> Stamps:
    """Rows that are farthest in some direction, ascending."""
    return np.unique((points @ _ALL_AROUND[points.shape[1]]).argmax(0))


def best_axes(points: Floats, before: Floats) -> Floats:
    """Axes of a small box around points, float64 [dim, dim] as columns; the last ones if they are as good.

    The candidates share an axis with the principal axes of the points. The size of a box is half its
    surface, in 2-D half its outline, which distinguish flat boxes.

    Parameters
    ----------
    points
        float64 [m, dim].
    before
        float64 [dim, dim], the last axes.
    """
    if len(points) > 2 * _MAX_POINTS:
        points = points[_farthest(points)]
    centred = points - points.mean(0)
    principal = np.linalg.eigh(centred.T @ centred)[1][:, ::-1]
    turns = _TURNS[points.shape[1]]
    sizes = _sizes(points @ principal, turns)
    best = int(sizes.argmin())
    if sizes[best] >= _SMALLER * _sizes(points, before[None])[0]:
        return before
    return _like(principal @ turns[best], before)


def _quarter_turns(dim: int) -> Floats:
    """Rotations about each principal axis, float64 [n, dim, dim]; all boxes are met within a right angle."""
    angles = np.arange(0, np.pi / 2, _STEP)
    c, s = np.cos(angles), np.sin(angles)
    found = []
    for p, q in ((0, 1), (1, 2), (0, 2))[: 3 if dim == 3 else 1]:
        turn = np.tile(np.eye(dim), (len(angles), 1, 1))
        turn[:, p, p] = turn[:, q, q] = c
        turn[:, q, p], turn[:, p, q] = s, -s
        found.append(turn)
    return np.concatenate(found)


_TURNS = {dim: _quarter_turns(dim) for dim in (2, 3)}


def _sizes(points: Floats, axes: Floats) -> Floats:
    """Half the surface (in 2-D the outline) of the boxes with axes [n, dim, dim], [n]."""
    dim = points.shape[1]
    along = points @ axes.transpose(1, 0, 2).reshape(dim, -1)
    a = (along.max(0) - along.min(0)).reshape(-1, dim)
    size = a.sum(1) if dim == 2 else a[:, 0] * a[:, 1] + a[:, 1] * a[:, 2] + a[:, 0] * a[:, 2]
    return np.asarray(size)


def _like(axes: Floats, before: Floats) -> Floats:
    """The same axes in the order and with the signs that turn them least from others; right-handed."""
    alike = before.T @ axes
    _, order = linear_sum_assignment(-np.abs(alike))
    found = axes[:, order]
    found = found * np.where((found * before).sum(0) < 0, -1.0, 1.0)
    if np.linalg.det(found) < 0:
        found[:, int(np.abs((found * before).sum(0)).argmin())] *= -1
    return found


def _box(extent: Extent, R: Floats, t: Floats) -> Box:
    """Box of the points in the axes of the space."""
    along = extent.points @ extent.axes
    low, high = along.min(0), along.max(0)
    turn = R @ extent.axes
    center = R @ (extent.axes @ ((low + high) / 2)) + t
    rotation = float(np.arctan2(turn[1, 0], turn[0, 0])) if len(t) == 2 else quaternion(turn).tolist()
    return Box(center=center.tolist(), half=((high - low) / 2).tolist(), rotation=rotation)
