"""Estimates the pose of camera B in the frame of camera A from common views of a target."""

import math
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
    poses_a = [planar_poses(camera_a, view.points, view.pixels_a) for view in views]
    poses_b = [planar_poses(camera_b, view.points, view.pixels_b) for view in views]
    candidates = [
        a.after(b.inverse()) for pa, pb in zip(poses_a, poses_b, strict=True) for _, a in pa for _, b in pb
    ]
    if not candidates:
        raise InputError("no pose fits the images of the target; is its size right?")
    chosen = candidates[:: max(1, len(candidates) // _MAX_CANDIDATES)]
    fits = [_fits(candidate, camera_b, views, poses_a) for candidate in chosen]
    errors = [np.median([fit[0] for fit in tried if fit is not None]) for tried in fits]
    best = int(np.argmin(errors))
    used = [(view, fit[1]) for view, fit in zip(views, fits[best], strict=True) if fit is not None]
    return _refine(camera_a, camera_b, used, chosen[best])


def _fits(
    b_to_a: Extrinsics,
    camera_b: Intrinsics,
    views: Sequence[PairedView],
    poses_a: Sequence[Sequence[tuple[float, Extrinsics]]],
) -> list[tuple[float, Extrinsics] | None]:
    """Of each view the pose of the target in A that fits both images best, with its error; None without any.

    A mirrored pose fits one image nearly as well, and in a single view any pose in A has one in B.
    """
    a_to_b = b_to_a.inverse()
    fits: list[tuple[float, Extrinsics] | None] = []
    for view, poses in zip(views, poses_a, strict=True):
        in_b = [reprojection(camera_b, a_to_b.after(pose), view.points, view.pixels_b) for _, pose in poses]
        errors = [(math.hypot(in_a, rms(part)), pose) for (in_a, pose), part in zip(poses, in_b, strict=True)]
        fits.append(min(errors, key=lambda fit: fit[0], default=None))
    return fits


def _pose(values: Floats) -> Extrinsics:
    return Extrinsics(Rotation.from_rotvec(values[:3]).as_matrix(), values[3:6])


def _vector(pose: Extrinsics) -> Floats:
    return np.concatenate([Rotation.from_matrix(pose.rotation).as_rotvec(), pose.translation])


def _refine(
    camera_a: Intrinsics,
    camera_b: Intrinsics,
    used: Sequence[tuple[PairedView, Extrinsics]],
    start: Extrinsics,
) -> RelativePose:
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
