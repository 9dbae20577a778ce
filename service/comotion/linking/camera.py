"""Undistorts pixels of a calibrated camera to image coordinates at focal length one."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from ..arrays import Floats
from ..config import Camera


class CameraModel:
    """A calibrated camera that does not move.

    Attributes
    ----------
    frame
        The metric space that the extrinsics lead to.
    rotation, translation
        float64 [3, 3] and [3] (m), camera to `frame`.
    focal
        px; geometric mean of the focal lengths.
    """

    def __init__(self, camera: Camera) -> None:
        self.frame = camera.frame
        self.rotation: Floats = Rotation.from_quat(camera.quaternion).as_matrix()
        self.translation: Floats = np.asarray(camera.translation)
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
