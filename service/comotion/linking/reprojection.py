"""Likelihood that image trajectories follow the projected motion of each body.

A body explains a trajectory if one point that is fixed to the body was always seen where the trajectory
was. The point is parametrised by where the feature was at a reference frame and by its inverse depth
there (Civera et al. 2008): in the camera's frame x_ref = (α, β, 1)/ρ. If it is fixed to a body, it is
at x_m = A_m x_ref + a_m at frame m, so that it is seen at the projection of A_m (α, β, 1) + ρ a_m,
which is linear in all three. They are fitted to the whole trajectory by Gauss-Newton.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..config import Camera
from ..partition import BodyMotion
from ..trajectories.window import Window

# States of a trajectory that are compared, spread over its life.
_STATES = 12
# px; noise of a feature whose source does not report it. That of a position after many steps is so many times
# the reported one of a step. Tracking drifts and calibration errs by a share of a displacement in the image.
# Chosen on seed 0 of the link experiment, see docs/research/linking.md.
_NOISE, _NOISE_FACTOR, _DRIFT = 0.3, 2.0, 0.02
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


class CameraModel:
    """A calibrated camera that does not move."""

    def __init__(self, camera: Camera) -> None:
        # The metric space that the extrinsics lead to, and these: float64 [3, 3], [3] in m.
        self.frame = camera.frame
        self.rotation: Floats = Rotation.from_quat(camera.quaternion).as_matrix()
        self.translation: Floats = np.asarray(camera.translation)
        # px; geometric mean of the focal lengths.
        self.focal = math.sqrt(camera.fx * camera.fy)
        self._matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        self._distortion = np.array(camera.distortion) if any(camera.distortion) else None
        if self._distortion is not None:
            import cv2  # noqa: F401, PLC0415 - takes a while: now rather than during an update

    def normalised(self, pixels: Floats) -> Floats:
        """Undistorted image coordinates at focal length one, float64 [N, 2], of pixels float64 [N, 2]."""
        if self._distortion is not None and len(pixels):
            import cv2  # noqa: PLC0415 - slow to import, and few cameras need it

            flat = cv2.undistortPoints(pixels[:, None], self._matrix, self._distortion)
            return np.asarray(flat.reshape(-1, 2), np.float64)
        return np.asarray((pixels - self._matrix[:2, 2]) / self._matrix.diagonal()[:2], np.float64)


@dataclass(frozen=True)
class ImageTracks:
    """N image trajectories at up to M of the bodies' frames each, oldest first."""

    frame: Ints
    """intp [N, M], index of the frame."""
    seen: Bools
    """bool [N, M]; False pads a trajectory with fewer states."""
    position: Floats
    """float64 [N, M, 2], undistorted, at focal length one."""
    variance: Floats
    """float64 [N], of a coordinate of `position`."""


def sample_tracks(window: Window, slots: Slots, stamps: Stamps, camera: CameraModel) -> ImageTracks:
    """States of trajectories, slots intp [N], at up to twelve of the frames each: ascending stamps int64 [F].

    Linear between observations, never across a gap longer than the window allows.
    """
    states = window.states_at(slots, stamps)
    # The frames of each with a state come first, of which some are taken, evenly spread.
    order, count = np.argsort(~states.held.T, axis=1, kind="stable"), states.held.sum(0)[:, None]
    place = np.arange(_STATES)
    spread = np.round(place * np.maximum(count - 1, 0) / (_STATES - 1)).astype(np.intp)
    seen = place < count
    frame = np.where(seen, np.take_along_axis(order, np.where(count > _STATES, spread, place * seen), 1), 0)
    pixels = np.where(seen[..., None], states.position[frame, np.arange(len(slots))[:, None]], 0.0)
    taken = np.maximum(seen.sum(1), 1)
    centred = pixels - pixels.sum(1, keepdims=True) / taken[:, None, None]
    extent = ((centred**2).sum(2) * seen).sum(1) / taken
    sigmas = [window.held(window.sigma, slot) for slot in slots.tolist()]
    reported = [sigma[np.isfinite(sigma)] for sigma in sigmas]
    noise = np.array([np.median(sigma) if len(sigma) else _NOISE for sigma in reported])
    return ImageTracks(
        frame=frame,
        seen=seen,
        position=camera.normalised(pixels.reshape(-1, 2)).reshape(*seen.shape, 2),
        variance=((_NOISE_FACTOR * noise) ** 2 + _DRIFT**2 * extent) / camera.focal**2,
    )


def log_likelihoods(tracks: ImageTracks, bodies: Sequence[BodyMotion], camera: CameraModel) -> Floats:
    """Log-likelihood of each trajectory on each body and, last, on none of them, float64 [N, K + 1].

    Relative to a constant of the trajectory. A frame without a pose is charged the expected residual. The K
    bodies move in the axes of the space that the camera's extrinsics lead to.
    """
    states = np.maximum(2 * tracks.seen.sum(1) - 3, 0)
    none = -0.5 * _NO_BODY_CHARGE * states
    return np.column_stack([*(_on_body(tracks, body, camera) for body in bodies), none])


class _Problem(NamedTuple):
    """Where a body is to be found in each frame of a trajectory, from u = (α, β, ρ) at its reference frame.

    The point is at p = `base` + `columns` u, float64 [N, M, 3] and [N, M, 3, 3], in the camera's axes in
    units of the depth at the reference frame. `pose_variance` [N, M] (m²) is that of a coordinate of the
    point by the pose's own uncertainty, `start` [N, 3] what is expected of u, and `spread` [N] that of the
    inverse depth.
    """

    base: Floats
    columns: Floats
    pose_variance: Floats
    start: Floats
    spread: Floats


def _on_body(tracks: ImageTracks, body: BodyMotion, camera: CameraModel) -> Floats:
    """Log-likelihood of each trajectory on a body, float64 [N]."""
    seen = tracks.seen & body.posed[tracks.frame]
    # The middle one of the states that count; the first where none does.
    rank = np.cumsum(seen, axis=1)
    problem = _problem(tracks, body, camera, np.argmax(seen & (rank > rank[:, -1:] // 2), axis=1))
    u = problem.start
    for step in range(_GAUSS_NEWTON_STEPS + 1):
        p = problem.base + (problem.columns @ u[:, None, :, None])[..., 0]
        front = p[..., 2] > _SMALLEST_DEPTH
        z = np.where(front, p[..., 2], 1.0)[..., None]
        residual = np.where(front[..., None], tracks.position - p[..., :2] / z, 1.0)
        # p is in units of the depth at the reference frame: the true depth is z / ρ.
        variance = tracks.variance[:, None] + problem.pose_variance * (u[:, 2:] / z[..., 0]) ** 2
        squared = (residual**2).sum(2) / variance
        off = (u[:, 2] - problem.start[:, 2]) / problem.spread
        if step == _GAUSS_NEWTON_STEPS:
            break
        weight = np.where(seen & front, 1 / (1 + squared / _LARGEST_SQUARE), 0.0) / variance
        J = problem.columns[..., :2, :] - (p[..., :2] / z)[..., None] * problem.columns[..., 2:, :]
        J /= z[..., None]
        left = np.einsum("nm,nmia,nmib->nab", weight, J, J)
        right = np.einsum("nm,nmia,nmi->na", weight, J, residual)
        # Never singular: a trajectory with no state at all stays where it is.
        left[:, [0, 1], [0, 1]] += 1e-6
        left[:, 2, 2] += 1 / problem.spread**2
        right[:, 2] -= off / problem.spread
        u = u + np.linalg.solve(left, right[..., None])[..., 0]
        u[:, 2] = np.maximum(u[:, 2], _SMALLEST_DEPTH)
    widened = 2 * np.log(variance / tracks.variance[:, None])
    charge = np.where(seen, np.minimum(squared, _LARGEST_SQUARE) + widened, 2.0 * tracks.seen)
    return np.asarray(-0.5 * (charge.sum(1) + off**2))


def _problem(tracks: ImageTracks, body: BodyMotion, camera: CameraModel, reference: Ints) -> _Problem:
    """Motion of a body from the reference states intp [N], and where its features are there."""
    rows = np.arange(len(tracks.frame))
    at, bearing = tracks.frame[rows, reference], tracks.position[rows, reference]
    C, c = camera.rotation, camera.translation
    centre = (body.R[at] @ body.centre + body.t[at] - c) @ C
    spread = np.maximum(_DEPTH_RADII * body.radius, _LEAST_DEPTH_SHARE * np.abs(centre[:, 2]))
    # The camera does not see a body beside or behind itself; its depth says nothing then.
    depth = np.maximum(centre[:, 2], spread)
    off = np.column_stack([bearing, np.ones(len(bearing))]) * depth[:, None] - centre
    # The uncertainty of a turn grows with the distance from the features that the pose was fitted to.
    lever = np.maximum((off**2).sum(1), body.radius**2)
    turn_variance = np.trace(body.turn_covariance, axis1=1, axis2=2) / 3
    pose_variance = body.place_variance[tracks.frame] + lever[:, None] * turn_variance[tracks.frame]
    turn = body.R[tracks.frame] @ body.R[at].transpose(0, 2, 1)[:, None]
    shift = body.t[tracks.frame] - np.einsum("nmij,nj->nmi", turn, body.t[at])
    # x' = turn x + shift in the space; with x = C y + c the same motion of y.
    A = C.T @ turn @ C
    a = (np.einsum("nmij,j->nmi", turn, c) + shift - c) @ C
    columns = np.concatenate([A[..., :2], a[..., None]], axis=3)
    start = np.column_stack([bearing, 1 / depth])
    return _Problem(A[..., 2], columns, pose_variance, start, spread / depth**2)
