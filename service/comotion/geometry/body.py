"""Fits a rigid body to rows: a template and its poses over the frames (step 6)."""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats, Ints, identities
from .frames import Frames
from .procrustes import fit_poses
from .records import ROUND, PoseArrays
from .rest import settle

# Iterations of a fit; chosen on the scenes of docs/research/accuracy.md.
_ITERATIONS = 4
# s that a rest takes at least; of .5 and .2, chosen on stress scenes of seed 1.
_LEAST_REST = 0.2


@dataclass(frozen=True)
class Body:
    """A candidate: a template b and poses x = R b + t over F frames.

    Attributes
    ----------
    rows
        intp [m], rows that it was fitted to; none for the static body.
    template
        float64 [m, 3], body coordinates of the rows.
    R, t, posed
        float64 [F, 3, 3], float64 [F, 3], bool [F] (whether the frame has a pose).
    dof
        Degrees of freedom of a pose: 3 in 2-D, 6 in 3-D, 5 for a pair in 3-D, 0 for the static body.
    free
        Number of poses that it is free to take; where it is settled (:func:`settled`), each rest has
        one.
    rests
        Whether it is settled, and rests in the newest frame.
    """

    rows: Ints
    template: Floats
    R: Floats
    t: Floats
    posed: Bools
    dof: int
    free: int = 0
    rests: bool = False

    @property
    def poses(self) -> PoseArrays:
        """The poses as arguments of kernels."""
        return PoseArrays(self.R, self.t, self.posed)

    @property
    def static(self) -> bool:
        """Whether it is the body that never moves."""
        return self.dof == 0


def static_body(count: int) -> Body:
    """The body at rest over `count` frames."""
    nothing = np.zeros(0, np.intp)
    return Body(
        nothing, np.zeros((0, 3)), identities(count), np.zeros((count, 3)), np.ones(count, np.bool_), 0
    )


def fit_body(frames: Frames, rows: Ints) -> Body:
    """Fit a body to rows intp [m]: generalised Procrustes with missing data and robust weights."""
    count = len(frames.stamps)
    poses = PoseArrays(identities(count), np.zeros((count, 3)), np.zeros(count, np.bool_))
    template = np.zeros((3, len(rows)))
    _fit(frames, rows, 0, np.eye(3), template, poses)
    pair = int((frames.w[rows] > 0).any(1).sum()) <= 2
    dof = 3 if frames.dim == 2 else (5 if pair else 6)
    return Body(rows, np.ascontiguousarray(template.T), *poses, dof, int(poses.posed.sum()))


def followed_body(frames: Frames, body: Body) -> Body:
    """The body with poses in the frames that it has none for."""
    first, count = len(body.t), len(frames.stamps)
    if body.static:
        return static_body(count)
    R, t, posed = identities(count), np.zeros((count, 3)), np.zeros(count, np.bool_)
    R[:first], t[:first], posed[:first] = body.poses
    newer = PoseArrays(R[first:], t[first:], posed[first:])
    _fit(frames, body.rows, first, R[first - 1], np.ascontiguousarray(body.template.T), newer)
    return replace(body, R=R, t=t, posed=posed)


def _fit(frames: Frames, rows: Ints, first: int, near: Floats, template: Floats, poses: PoseArrays) -> None:
    """Fit poses from a frame on, and from the first one on the template [3, m] as well, in place."""
    # The inner loops of the kernel run over the rows of a frame.
    y = np.ascontiguousarray(frames.y[rows, first:].transpose(1, 2, 0))
    w = np.ascontiguousarray(frames.w[rows, first:].T)
    noise = 1 / frames.tolerance[rows], frames.metric[rows]
    fit_poses(y, w, *noise, frames.dim, near, _ITERATIONS, first > 0, template, poses)


def settled(frames: Frames, body: Body) -> Body:
    """The body with one pose for each rest, so that its poses do not fit noise.

    A body has a pose in each frame, also while it rests. Those poses fit the noise of the rows that the body
    was fitted to, so that a resting feature that is no part of the body may cost less under it than at rest.
    With one pose for each rest, both costs are the same, and position and memory decide; and a rest has the
    price of one pose. A body that moves slowly rests for a few frames at a time: it has as many poses as its
    noise lets tell apart.
    """
    if body.static or not body.posed.any():
        return body
    still = replace(body, R=body.R.copy(), t=body.t.copy())
    w = np.ascontiguousarray(frames.w[body.rows].T)
    # Not the tolerance: a body that moves slowly, within its slack, does not rest.
    noise = 1 / frames.noise[body.rows], frames.metric[body.rows]
    template, rests = np.ascontiguousarray(body.template.T), np.zeros(len(body.t), np.bool_)
    least = _LEAST_REST * frames.config.frame_rate
    runs = settle(w, *noise, template, frames.dim, body.dof, least, still.poses, rests)
    moving = int(np.count_nonzero(body.posed & ~rests))
    return replace(still, free=runs + moving, rests=bool(rests[-1]))


def stacked(bodies: list[Body]) -> Floats:
    """Poses of K bodies in the layout of the cost kernels, float64 [K, F, 13].

    Each is R row by row, t, and whether the frame has a pose: 1 or 0.
    """
    poses = np.empty((len(bodies), len(bodies[0].t), 13))
    for k, body in enumerate(bodies):
        poses[k, :, :9], poses[k, :, 9:12] = body.R.reshape(-1, 9), body.t
        poses[k, :, 12] = body.posed
    return poses


def align(source: Floats, target: Floats, dim: int, near: Floats) -> tuple[Floats, Floats]:
    """Least-squares rigid transform of points to others, target = R source + t, float64 [3, 3] and [3].

    Parameters
    ----------
    source, target
        float64 [m, 3], m > 0; the third column is zero in 2-D, where R is a rotation about z.
    near
        float64 [3, 3]; where the points leave a rotation open, as a pair does, R is the nearest to this one.
    """
    y, b, equal = target.T[None].copy(), np.ascontiguousarray(source.T), np.ones((1, len(source)))
    pose = PoseArrays(np.zeros((1, 3, 3)), np.zeros((1, 3)), np.zeros(1, np.bool_))
    fit_poses(y, equal, equal[0], np.tile(ROUND, (len(source), 1)), dim, near, 1, True, b, pose)
    return pose.R[0], pose.t[0]


def pose_columns(b: Floats, dim: int) -> Floats:
    """Derivatives of points [m, 3] by a small rotation and shift, [m, 3, 6]; zero in a third of 2-D."""
    J = np.zeros((len(b), 3, 6))
    J[:, 0, 1], J[:, 0, 2], J[:, 1, 2] = b[:, 2], -b[:, 1], b[:, 0]
    J[:, :, :3] -= J[:, :, :3].transpose(0, 2, 1).copy()
    J[:, :, 3:] = np.eye(3)
    J[:, dim:] = 0.0
    return J


def pose_information(frames: Frames, rows: Ints, template: Floats, tolerance: Floats) -> Floats:
    """Inverse covariance of the errors of a body's poses, in its frame: rotation vector and shift, [F, 6, 6].

    Parameters
    ----------
    rows, template, tolerance
        intp [m], float64 [m, 3] and [m]: the rows that the body was fitted to, their places in the body, and
        their variances.
    """
    J = pose_columns(template, frames.dim)
    once = np.einsum("mcp,mcq->mpq", J, J).reshape(len(rows), -1)
    seen = (frames.w[rows] > 0) / tolerance[:, None]
    return np.asarray((seen.T @ once).reshape(-1, 6, 6))
