"""Poses of a flat target from its points in one image; up to two poses fit nearly as well."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .model import Extrinsics, Intrinsics

Floats = NDArray[np.float64]

_FAILED_PX = 2.0
"""A reprojection error above this means that IPPE failed; corners are found to a few tenths of a pixel."""


def planar_poses(camera: Intrinsics, points: Floats, pixels: Floats) -> list[tuple[float, Extrinsics]]:
    """Find the poses (target to camera) that fit the image of a flat target, best first.

    Parameters
    ----------
    camera
        Intrinsics of the camera.
    points
        float64 [M, 3], M >= 4, points of the target with z = 0, in m.
    pixels
        float64 [M, 2], the same points in the image.

    Returns
    -------
    At most three pairs: root mean square reprojection error in px, and pose. None is behind the camera.
    """
    poses = _solve(camera, points, pixels, cv2.SOLVEPNP_IPPE)
    # OpenCV's IPPE fails where the symmetry axis of the target meets the optical axis: reprojection
    # errors of 20 to 80 px for exact corners (5 of 216 poses; IPPE_SQUARE: 11 of 216).
    if not poses or poses[0][0] > _FAILED_PX:
        poses += _solve(camera, points, pixels, cv2.SOLVEPNP_ITERATIVE)
    return sorted(poses, key=lambda candidate: candidate[0])


def reprojection(camera: Intrinsics, pose: Extrinsics, points: Floats, pixels: Floats) -> Floats:
    """Reprojection errors, float64 [M, 2] px; 10⁴ px if a point is behind the camera."""
    seen = pose.apply(points)
    if (seen[:, 2] <= 0).any():
        return np.full((len(points), 2), 1e4)
    return camera.project(seen) - pixels


def rms(errors: Floats) -> float:
    """Root mean square length of errors [..., 2]."""
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


def _solve(camera: Intrinsics, points: Floats, pixels: Floats, method: Any) -> list[tuple[float, Extrinsics]]:
    count, rotations, translations, _ = cv2.solvePnPGeneric(
        points, pixels, camera.matrix, camera.distortion, flags=method
    )
    poses = []
    for rotation, translation in zip(rotations[:count], translations[:count], strict=True):
        values = np.concatenate([np.ravel(rotation), np.ravel(translation)]).astype(np.float64)
        if np.isfinite(values).all() and values[5] > 0:
            pose = Extrinsics.from_vector(values)
            poses.append((rms(reprojection(camera, pose, points, pixels)), pose))
    return sorted(poses, key=lambda pair: pair[0])
