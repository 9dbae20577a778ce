"""Likelihood that image trajectories follow the projected motion of each body.

A body explains a trajectory if one point that is fixed to the body was always seen where the trajectory
was. The point is parametrised by where the feature was at a reference frame and by its inverse depth
there (Civera et al. 2008): in the camera's frame x_ref = (α, β, 1)/ρ. If it is fixed to a body, it is
at x_m = A_m x_ref + a_m at frame m, so that it is seen at the projection of A_m (α, β, 1) + ρ a_m,
which is linear in all three. They are fitted to the whole trajectory by Gauss-Newton.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..partition import BodyMotion
from .camera import CameraModel
from .image_tracks import ImageTracks

_GAUSS_NEWTON_STEPS = 3
# Squared residual of a state, in variances, from which on it costs no more.
_LARGEST_SQUARE = 40.0
# A camera elsewhere sees other parts of a body than the features it is known by: depths within
# so many radii of their centroid are credible, and never less than this share of the distance.
# Chosen on seed 0 of the link experiment, see docs/research/linking.md.
_DEPTH_RADII = 2.0
_LEAST_DEPTH_SHARE = 0.05
# Charge of a trajectory on none of the bodies, as a multiple of the expected residual; likewise.
_NO_BODY_CHARGE = 4.0
# Smallest inverse depth, 1/m, and smallest depth of a visible point, in units of the reference depth.
_SMALLEST_DEPTH = 1e-3


def log_likelihoods(tracks: ImageTracks, bodies: Sequence[BodyMotion], camera: CameraModel) -> Floats:
    """Log-likelihood of each trajectory on each body and, last, on none of them, float64 [N, K + 1].

    Relative to a constant of the trajectory. A frame without a pose is charged the expected residual.

    Parameters
    ----------
    tracks
        N image trajectories.
    bodies
        Motion of K bodies in the axes of the space that the camera's extrinsics lead to.
    camera
        Calibration.
    """
    found = np.zeros((len(tracks.frame), len(bodies) + 1))
    for k, body in enumerate(bodies):
        found[:, k] = _on_body(tracks, body, camera)
    states = np.maximum(2 * tracks.seen.sum(1) - 3, 0)
    found[:, -1] = -0.5 * _NO_BODY_CHARGE * states
    return found


class _Motion(NamedTuple):
    """Motion of a body in the camera's axes from each trajectory's reference frame.

    `A` [N, M, 3, 3] and `a` [N, M, 3] lead to frame m, `pose_variance` [N, M] (m²) is that of a coordinate
    of the point by the pose's own uncertainty.
    """

    A: Floats
    a: Floats
    pose_variance: Floats


class _Prior(NamedTuple):
    """Bearing [N, 2] and inverse depth [N] that the fit starts from, and the spread of the latter [N]."""

    bearing: Floats
    inverse_depth: Floats
    spread: Floats


class _View(NamedTuple):
    """Where points of a body are seen.

    `p` [N, M, 3] is their position in units of the reference depth, `z` its depth, positive where `front`;
    `residual` [N, M, 2], its `variance` and, in units of that, its square `squared` [N, M].
    """

    p: Floats
    z: Floats
    front: Bools
    residual: Floats
    variance: Floats
    squared: Floats


def _on_body(tracks: ImageTracks, body: BodyMotion, camera: CameraModel) -> Floats:
    """Log-likelihood of each trajectory on a body, float64 [N]."""
    seen = tracks.seen & body.posed[tracks.frame]
    motion, prior = _motion_and_prior(tracks, body, camera, _middle(seen))
    u = np.column_stack([prior.bearing, prior.inverse_depth])
    information = np.zeros(len(u))
    for _ in range(_GAUSS_NEWTON_STEPS):
        view = _predict(tracks, motion, u)
        weight = np.where(seen & view.front, 1 / (1 + view.squared / _LARGEST_SQUARE), 0.0) / view.variance
        pull = (prior.inverse_depth - u[:, 2]) / prior.spread**2
        step, information = _gauss_newton(motion, view, weight, pull, prior.spread)
        u = u + step
        u[:, 2] = np.maximum(u[:, 2], _SMALLEST_DEPTH)
    view = _predict(tracks, motion, u)
    widened = 2 * np.log(view.variance / tracks.variance[:, None])
    charge = np.where(seen, np.minimum(view.squared, _LARGEST_SQUARE) + widened, 2.0 * tracks.seen)
    off = ((u[:, 2] - prior.inverse_depth) / prior.spread) ** 2
    # Laplace's approximation: the fitted depth costs the more the better the trajectory determines it.
    occam = np.log1p(prior.spread**2 * information)
    return np.asarray(-0.5 * (charge.sum(1) + off + occam))


def _middle(seen: Bools) -> Ints:
    """Index of the middle one of the states that count, intp [N]; 0 where none does."""
    rank = np.cumsum(seen, axis=1)
    return np.asarray(np.argmax(seen & (rank > rank[:, -1:] // 2), axis=1), np.intp)


def _motion_and_prior(
    tracks: ImageTracks, body: BodyMotion, camera: CameraModel, reference: Ints
) -> tuple[_Motion, _Prior]:
    """Motion of a body from the reference states intp [N], and where its features are there."""
    rows = np.arange(len(tracks.frame))
    at = tracks.frame[rows, reference]
    bearing = tracks.position[rows, reference]
    centre = body.R[at] @ body.centre + body.t[at]
    inside = (centre - camera.translation) @ camera.rotation
    spread = np.maximum(_DEPTH_RADII * body.radius, _LEAST_DEPTH_SHARE * np.abs(inside[:, 2]))
    # The camera does not see a body beside or behind itself; its depth says nothing then.
    z = np.maximum(inside[:, 2], spread)
    off = np.column_stack([bearing, np.ones(len(bearing))]) * z[:, None] - inside
    # The uncertainty of a turn grows with the distance from the features that the pose was fitted to.
    lever = np.maximum((off**2).sum(1), body.radius**2)
    turn_variance = np.trace(body.turn_covariance, axis1=1, axis2=2) / 3
    pose_variance = body.place_variance[tracks.frame] + lever[:, None] * turn_variance[tracks.frame]
    A, a = _relative(body, camera, tracks.frame, at)
    return _Motion(A, a, pose_variance), _Prior(bearing, 1 / z, spread / z**2)


def _relative(body: BodyMotion, camera: CameraModel, frame: Ints, at: Ints) -> tuple[Floats, Floats]:
    """Motion of a body from frame at [N] to frame [N, M] in the camera's axes: [N, M, 3, 3], [N, M, 3]."""
    C, c = camera.rotation, camera.translation
    turn = body.R[frame] @ body.R[at].transpose(0, 2, 1)[:, None]
    shift = body.t[frame] - np.einsum("nmij,nj->nmi", turn, body.t[at])
    # x' = turn x + shift in the space; with x = C y + c the same motion of y.
    A = C.T @ turn @ C
    a = (np.einsum("nmij,j->nmi", turn, c) + shift - c) @ C
    return A, a


def _predict(tracks: ImageTracks, motion: _Motion, u: Floats) -> _View:
    """Where points u = (α, β, ρ) [N, 3] are seen, against where the trajectories were."""
    ray = np.append(u[:, :2], np.ones((len(u), 1)), 1)
    p = np.einsum("nmij,nj->nmi", motion.A, ray) + u[:, None, 2:] * motion.a
    front = p[..., 2] > _SMALLEST_DEPTH
    z = np.where(front, p[..., 2], 1.0)
    residual = np.where(front[..., None], tracks.position - p[..., :2] / z[..., None], 1.0)
    # p is in units of the depth at the reference frame: the true depth is z / ρ.
    variance = tracks.variance[:, None] + motion.pose_variance * (u[:, 2:] / z) ** 2
    return _View(p, z, front, residual, variance, (residual**2).sum(2) / variance)


def _gauss_newton(
    motion: _Motion, view: _View, weight: Floats, pull: Floats, spread: Floats
) -> tuple[Floats, Floats]:
    """Step [N, 3] of (α, β, ρ), and the information on ρ when α and β are free, [N]."""
    columns = np.concatenate([motion.A[..., :2], motion.a[..., None]], axis=3)
    q = view.p[..., :2] / view.z[..., None]
    J = (columns[..., :2, :] - q[..., None] * columns[..., 2:, :]) / view.z[..., None, None]
    left = np.einsum("nm,nmia,nmib->nab", weight, J, J)
    right = np.einsum("nm,nmia,nmi->na", weight, J, view.residual)
    # Never singular: a trajectory with no state at all stays where it is.
    left[:, [0, 1], [0, 1]] += 1e-6
    lateral = np.linalg.solve(left[:, :2, :2], left[:, :2, 2:])
    information = left[:, 2, 2] - np.einsum("ni,ni->n", left[:, 2, :2], lateral[..., 0])
    left[:, 2, 2] += 1 / spread**2
    right[:, 2] += pull
    return np.linalg.solve(left, right[..., None])[..., 0], np.maximum(information, 0.0)
