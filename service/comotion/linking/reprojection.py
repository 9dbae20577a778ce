"""How well a body explains an image trajectory: by one point of it that was always seen there.

The point is parametrised by where the feature was at a reference frame and by its inverse depth
there (Civera et al. 2008): in the camera's frame x_ref = (α, β, 1)/ρ. If it rides on a body, it is
at x_m = A_m x_ref + a_m at frame m, so that it is seen at the projection of A_m (α, β, 1) + ρ a_m,
which is linear in all three. They are fitted to the whole trajectory; the residual judges the body.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats
from ..rigid.poses import Poses
from .camera import CameraModel
from .sightings import Sightings

ITERATIONS = 3
# Squared residual of a state, in variances, from which on it costs no more.
CAP = 40.0
# What is not on any of the bodies is charged this many times the expected residual.
STRANGER = 4.0
# A camera elsewhere sees other parts of a body than the features it is known by: depths within
# so many radii of their centroid are credible, and never less than this share of the distance.
_RADII = 2.0
_LEAST_SPREAD = 0.05
_NEAREST = 1e-3


def log_likelihoods(sightings: Sightings, poses: Poses, camera: CameraModel) -> Floats:
    """Log-likelihood of each trajectory on each body and, last, on none of them, float64 [N, K + 1].

    Relative to a constant of the trajectory. A frame without a pose is charged the expected residual.
    """
    found = np.zeros((len(sightings.frame), len(poses.ids) + 1))
    for k in range(len(poses.ids)):
        found[:, k] = _on_body(sightings, poses, camera, k)
    states = np.maximum(2 * sightings.seen.sum(1) - 3, 0)
    found[:, -1] = -0.5 * STRANGER * states
    return found


def _on_body(sightings: Sightings, poses: Poses, camera: CameraModel, k: int) -> Floats:
    """Log-likelihood of each trajectory on body k, float64 [N]."""
    rows = np.arange(len(sightings.frame))
    seen = sightings.seen & poses.posed[k][sightings.frame]
    reference = _middle(seen)
    at = sightings.frame[rows, reference]
    A, a = _relative(poses, camera, k, sightings.frame, at)
    place = sightings.place[rows, reference]
    prior, spread, shake = _priors(poses, camera, k, at, sightings.frame, place)
    u = np.column_stack([place, prior])
    information = np.zeros(len(rows))
    for _ in range(ITERATIONS):
        view = _predict(sightings, A, a, shake, u)
        weight = np.where(seen & view.front, 1 / (1 + view.squared / CAP), 0.0) / view.variance
        step, information = _step(A, a, view, weight, (prior - u[:, 2]) / spread**2, spread)
        u = u + step
        u[:, 2] = np.maximum(u[:, 2], _NEAREST)
    view = _predict(sightings, A, a, shake, u)
    widened = 2 * np.log(view.variance / sightings.variance[:, None])
    charge = np.where(seen, np.minimum(view.squared, CAP) + widened, 2.0 * sightings.seen)
    off = ((u[:, 2] - prior) / spread) ** 2
    # Laplace: the depth was fitted, and is worth what it could have been beyond what it is.
    occam = np.log1p(spread**2 * information)
    return np.asarray(-0.5 * (charge.sum(1) + off + occam))


@dataclass(frozen=True)
class _View:
    """Where points of a body are seen.

    `p` [N, M, 3] is their place in units of the reference depth, `z` its depth, positive where `front`;
    `residual` [N, M, 2], its `variance` and, in units of that, its square `squared` [N, M].
    """

    p: Floats
    z: Floats
    front: Bools
    residual: Floats
    variance: Floats
    squared: Floats


def _predict(sightings: Sightings, A: Floats, a: Floats, shake: Floats, u: Floats) -> _View:
    ray = np.append(u[:, :2], np.ones((len(u), 1)), 1)
    p = np.einsum("nmij,nj->nmi", A, ray) + u[:, None, 2:] * a
    front = p[..., 2] > _NEAREST
    z = np.where(front, p[..., 2], 1.0)
    residual = np.where(front[..., None], sightings.place - p[..., :2] / z[..., None], 1.0)
    # p is in units of the depth at the reference frame: the true depth is z / ρ.
    variance = sightings.variance[:, None] + shake * (u[:, 2:] / z) ** 2
    return _View(p, z, front, residual, variance, (residual**2).sum(2) / variance)


def _middle(seen: Bools) -> NDArray[np.intp]:
    """Index of the middle one of the states that count, intp [N]; 0 where none does."""
    rank = np.cumsum(seen, axis=1)
    return np.asarray(np.argmax(seen & (rank > rank[:, -1:] // 2), axis=1), np.intp)


def _relative(
    poses: Poses, camera: CameraModel, k: int, frame: NDArray[np.intp], at: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Motion of body k from frame at [N] to frame [N, M] in the camera's axes: [N, M, 3, 3], [N, M, 3]."""
    C, c = camera.rotation, camera.translation
    turn = poses.R[k][frame] @ poses.R[k][at].transpose(0, 2, 1)[:, None]
    shift = poses.t[k][frame] - np.einsum("nmij,nj->nmi", turn, poses.t[k][at])
    # x' = turn x + shift in the space; with x = C y + c the same motion of y.
    A = C.T @ turn @ C
    a = (np.einsum("nmij,j->nmi", turn, c) + shift - c) @ C
    return A, a


def _priors(
    poses: Poses, camera: CameraModel, k: int, at: NDArray[np.intp], frame: NDArray[np.intp], place: Floats
) -> tuple[Floats, Floats, Floats]:
    """Inverse depth of the body's features at a frame and how far it may spread, [N] each.

    And the variance by which the pose's own uncertainty shakes a coordinate of the point, [N, M]: that
    of a turn grows with the distance from the features that the pose was fitted to.
    """
    centre = np.einsum("nij,j->ni", poses.R[k][at], poses.centre[k]) + poses.t[k][at]
    inside = (centre - camera.translation) @ camera.rotation
    spread = np.maximum(_RADII * poses.radius[k], _LEAST_SPREAD * np.abs(inside[:, 2]))
    # A body beside or behind the camera is not seen by it; its depth says nothing then.
    z = np.maximum(inside[:, 2], spread)
    off = np.column_stack([place, np.ones(len(place))]) * z[:, None] - inside
    lever = np.maximum((off**2).sum(1), poses.radius[k] ** 2)
    shake = poses.place_variance[k][frame] + lever[:, None] * poses.turn_variance[k][frame]
    return 1 / z, spread / z**2, shake


def _step(
    A: Floats, a: Floats, view: _View, weight: Floats, pull: Floats, spread: Floats
) -> tuple[Floats, Floats]:
    """Gauss-Newton step [N, 3] of (α, β, ρ), and the information on ρ when α and β are free, [N]."""
    columns = np.concatenate([A[..., :2], a[..., None]], axis=3)
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
