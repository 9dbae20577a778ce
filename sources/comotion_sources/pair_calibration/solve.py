"""Estimates the pose of camera B in the frame of camera A from common views of a target."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ..calibration.model import Extrinsics, Intrinsics
from ..calibration.planar import planar_poses, reprojection, rms
from ..errors import InputError

Floats = NDArray[np.float64]

_ROBUST_PX = 1.0  # soft L1: larger reprojection errors count linearly
_MAX_CANDIDATES = 60  # start values that are scored: 15 views with two poses in each image


@dataclass(frozen=True, eq=False)
class PairedView:
    """One view of a target by both cameras: points float64 [M, 3] in m, pixels [M, 2] in A and in B."""

    points: Floats
    pixels_a: Floats
    pixels_b: Floats


@dataclass(frozen=True, eq=False)
class RelativePose:
    """Transformation from B to A, and root mean square reprojection errors in px in A and in B."""

    b_to_a: Extrinsics
    error_a: float
    error_b: float


def relative_pose(camera_a: Intrinsics, camera_b: Intrinsics, views: Sequence[PairedView]) -> RelativePose:
    """Estimate the pose of camera B in the frame of camera A.

    Each view alone gives candidates for the pose. The candidate with the least median error over
    all views is refined, together with the pose of the target in each view, by least squares over the
    reprojection errors in both images (robust: soft L1 beyond 1 px).

    Parameters
    ----------
    camera_a, camera_b
        Intrinsics.
    views
        Common views of the target.

    Raises
    ------
    InputError
        If there is no view, or no view gives a pose.
    """
    if not views:
        raise InputError("the target was never seen by both cameras")
    poses_a = [_poses(camera_a, view.points, view.pixels_a) for view in views]
    poses_b = [_poses(camera_b, view.points, view.pixels_b) for view in views]
    candidates = [
        a.after(b.inverse()) for pa, pb in zip(poses_a, poses_b, strict=True) for a in pa for b in pb
    ]
    if not candidates:
        raise InputError("no pose fits the images of the target; is its size right?")
    chosen = candidates[:: max(1, len(candidates) // _MAX_CANDIDATES)]
    scored = [(_score(c, camera_b, views, poses_a), i) for i, c in enumerate(chosen)]
    start = chosen[min(scored)[1]]
    targets = [_best_target(start, camera_b, view, poses) for view, poses in zip(views, poses_a, strict=True)]
    return _refine(camera_a, camera_b, views, start, targets)


def _poses(camera: Intrinsics, points: Floats, pixels: Floats) -> list[Extrinsics]:
    return [pose for _, pose in planar_poses(camera, points, pixels)]


def _pose(values: Floats) -> Extrinsics:
    return Extrinsics(Rotation.from_rotvec(values[:3]).as_matrix(), values[3:6])


def _vector(pose: Extrinsics) -> Floats:
    return np.concatenate([Rotation.from_matrix(pose.rotation).as_rotvec(), pose.translation])


def _error_in_b(b_to_a: Extrinsics, camera: Intrinsics, view: PairedView, target: Extrinsics) -> float:
    return rms(reprojection(camera, b_to_a.inverse().after(target), view.points, view.pixels_b))


def _best_target(
    b_to_a: Extrinsics, camera_b: Intrinsics, view: PairedView, poses: list[Extrinsics]
) -> Extrinsics | None:
    return min(poses, key=lambda pose: _error_in_b(b_to_a, camera_b, view, pose), default=None)


def _score(
    b_to_a: Extrinsics, camera_b: Intrinsics, views: Sequence[PairedView], poses_a: list[list[Extrinsics]]
) -> float:
    errors = []
    for view, poses in zip(views, poses_a, strict=True):
        target = _best_target(b_to_a, camera_b, view, poses)
        if target is not None:
            errors.append(_error_in_b(b_to_a, camera_b, view, target))
    return float(np.median(errors))


def _refine(
    camera_a: Intrinsics,
    camera_b: Intrinsics,
    views: Sequence[PairedView],
    start: Extrinsics,
    targets: list[Extrinsics | None],
) -> RelativePose:
    used = [(view, target) for view, target in zip(views, targets, strict=True) if target is not None]

    def errors(values: Floats) -> tuple[Floats, Floats]:
        a_to_b = _pose(values[:6]).inverse()
        of_a, of_b = [], []
        for i, (view, _) in enumerate(used):
            target = _pose(values[6 * i + 6 : 6 * i + 12])
            of_a.append(reprojection(camera_a, target, view.points, view.pixels_a))
            of_b.append(reprojection(camera_b, a_to_b.after(target), view.points, view.pixels_b))
        return np.concatenate(of_a), np.concatenate(of_b)

    first = np.concatenate([_vector(start), *(_vector(target) for _, target in used)])
    solution = least_squares(
        lambda values: np.concatenate(errors(values)).ravel(), first, loss="soft_l1", f_scale=_ROBUST_PX
    )
    of_a, of_b = errors(solution.x)
    return RelativePose(_pose(solution.x[:6]), rms(of_a), rms(of_b))
