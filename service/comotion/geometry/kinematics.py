"""Twist of a body now and its pose since birth, smoothed over its poses in the frames.

A pose at one frame is as noisy as the observations of that frame. Poses are therefore those of a local
cubic, by least squares over a short span: at the newest frame over the span before it, in the past over a
span on both sides.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comotion_schemas import Pose, Twist

from ..arrays import Bools, Floats, Stamps
from ..partition import PoseReference
from .body import Body, align
from .frames import Frames
from .rotation import quaternion, rotation_matrix, rotation_vectors

# s and degree of the polynomial. A longer span has less noise, a shorter one follows jerk. Measured on bodies
# of 10 features at 5 mm: a quadratic over 0.6 s errs by 1.2 degrees and 6.9 % of the velocity, a cubic over
# 1.6 s by 1.0 degrees and 5.9 %.
_SPAN = 1.6
_DEGREE = 3
# rad; rotation vectors far from zero wrap and do not add. Frames that are rotated by more are left out.
_TURN = 2.0


@dataclass(frozen=True)
class Local:
    """Smoothed pose x = R b + t at a frame and the motion there.

    `R` float64 [3, 3], `t`, `linear` (of the given point of the body), `angular` float64 [3].
    """

    R: Floats
    t: Floats
    linear: Floats
    angular: Floats


def local_motions(frames: Frames, bodies: list[Body], at_ns: int, points: list[Floats]) -> list[Local | None]:
    """Pose and velocities of bodies at a time, by local least squares; None for one without a pose near.

    Parameters
    ----------
    points
        float64 [3] each, body coordinates of the point whose velocity is returned (the centroid).
    """
    seconds = np.asarray((frames.stamps - at_ns) * 1e-9, np.float64)
    # A span centred on the time where there are frames on both sides, else all of it on one side.
    low = max(-_SPAN / 2, float(seconds[0]))
    high = min(low + _SPAN, float(seconds[-1]))
    near = slice(*np.searchsorted(seconds, [min(low, high - _SPAN) - 1e-6, high + 1e-6]))
    seconds, point = seconds[near], np.array(points)
    R, t = np.stack([body.R[near] for body in bodies]), np.stack([body.t[near] for body in bodies])
    used = np.stack([body.posed[near] for body in bodies])
    distance = np.where(used, np.abs(seconds), np.inf)
    has_pose = distance.min(1) <= _SPAN
    middle = R[np.arange(len(R)), distance.argmin(1)]
    turns = rotation_vectors((R @ middle[:, None].swapaxes(2, 3)).reshape(-1, 3, 3)).reshape(t.shape)
    used &= np.linalg.norm(turns, axis=2) < _TURN
    places = np.einsum("kfij,kj->kfi", R, point) + t
    value, slope = _polynomials(seconds, np.concatenate([places, turns], 2), used)
    motions: list[Local | None] = [None] * len(bodies)
    for k in np.flatnonzero(has_pose).tolist():
        pose = rotation_matrix(value[k, 3:]) @ middle[k]
        motions[k] = Local(pose, value[k, :3] - pose @ point[k], slope[k, :3], slope[k, 3:])
    return motions


def _polynomials(seconds: Floats, values: Floats, used: Bools) -> tuple[Floats, Floats]:
    """Value and slope at zero of least-squares polynomials of values [K, n, p] over [n], [K, p] each.

    `used` bool [K, n] are the values that count.
    """
    # Bodies that were posed in the same frames share one solution.
    used = used[: 1 if (used == used[:1]).all() else None]
    # Each degree needs two more samples to be better than noise.
    count = used.sum(1)
    degree = np.minimum(_DEGREE, np.maximum((count - 1) // 2, count > 1))
    powers = np.arange(_DEGREE + 1)
    design = (seconds[:, None] / _SPAN) ** powers * (used[:, :, None] & (powers <= degree[:, None, None]))
    coefficients = np.linalg.pinv(design) @ values
    return coefficients[:, 0], coefficients[:, 1] / _SPAN


def follow(
    reference: PoseReference,
    frames: Frames,
    body: Body,
    now: Local,
    local: Callable[[int], Local | None],
) -> None:
    """Update a hypothesis' pose since birth from its body's poses.

    While the birth is in the window, the reference is the body's own pose at birth, which is better known at
    each fit. After that, the body is aligned with those early members that remain; without any, with its last
    pose.

    Parameters
    ----------
    now
        Motion at the newest frame.
    local
        Motion of the body at a time.
    """
    axes = reference.axes
    if axes is None or axes[0] is not body.template:
        axes = reference.axes = _referred(reference, frames, body, local)
    _, R, t = axes
    # (R, t) takes body coordinates to the axes at birth; x(now) = R_now R^T (x(born) - t) + t_now.
    reference.R = now.R @ R.T
    reference.t = now.t - reference.R @ t
    reference.stamp_ns = int(frames.stamps[-1])


def _referred(
    reference: PoseReference, frames: Frames, body: Body, local: Callable[[int], Local | None]
) -> tuple[Floats, Floats, Floats]:
    """Refer a body that has been fitted anew to the axes of the space at birth: its template, R and t."""
    names = frames.names[body.rows]
    R, t = _from_birth(reference, frames, body, names, local)
    if reference.born_ns >= int(frames.stamps[0]):
        reference.rows, reference.points = names, body.template @ R.T + t
    else:
        # Sorting is faster than the table of all names between the least and the largest.
        in_reference = np.isin(names, reference.rows, assume_unique=True, kind="sort")
        in_body = np.isin(reference.rows, names, assume_unique=True, kind="sort")
        reference.rows = np.concatenate([reference.rows[in_body], names[~in_reference]])
        reference.points = np.concatenate([reference.points[in_body], body.template[~in_reference] @ R.T + t])
    return body.template, R, t


def _from_birth(
    reference: PoseReference, frames: Frames, body: Body, names: Stamps, local: Callable[[int], Local | None]
) -> tuple[Floats, Floats]:
    """Transform from body coordinates to the axes of the space at birth."""
    if reference.born_ns >= int(frames.stamps[0]) and (at_birth := local(reference.born_ns)) is not None:
        return at_birth.R, at_birth.t
    shared, own, other = np.intersect1d(names, reference.rows, assume_unique=True, return_indices=True)
    if len(shared) >= min(frames.dim, max(len(names), 2)):
        # Rotations that the points leave open, such as that of a pair about its axis, stay as they were.
        near = body.R[np.argmin(np.abs(frames.stamps - reference.stamp_ns))]
        return align(body.template[own], reference.points[other], frames.dim, reference.R.T @ near)
    last = local(reference.stamp_ns)
    if last is None:
        return np.eye(3), np.zeros(3)
    # x(last) = reference.R x(born) + reference.t and x(last) = last.R b + last.t.
    return reference.R.T @ last.R, reference.R.T @ (last.t - reference.t)


def as_pose(R: Floats, t: Floats, dim: int) -> Pose:
    """Pose in the protocol's terms."""
    if dim == 2:
        return Pose.trusted(translation=t[:2].tolist(), rotation=float(np.arctan2(R[1, 0], R[0, 0])))
    return Pose.trusted(translation=t.tolist(), rotation=quaternion(R).tolist())


def as_twist(linear: Floats, angular: Floats, dim: int) -> Twist:
    """Twist in the protocol's terms."""
    if dim == 2:
        return Twist.trusted(linear=linear[:2].tolist(), angular=float(angular[2]))
    return Twist.trusted(linear=linear.tolist(), angular=angular.tolist())


def centroid_of(body: Body, newest: Floats) -> Floats:
    """Centroid of the members now, by their newest positions [n, 3], in body coordinates, float64 [3].

    That of the rows that the body was fitted to, where it has no member or no pose.
    """
    if body.static:
        return np.zeros(3)
    if not len(newest) or not body.posed.any():
        return np.asarray(body.template.mean(0))
    last = body.posed.nonzero()[0][-1]
    return np.asarray((newest.sum(0) / len(newest) - body.t[last]) @ body.R[last])
