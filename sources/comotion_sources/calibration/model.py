"""Camera models: intrinsics (pinhole with OpenCV's distortion), extrinsics (camera to world).

Optical axes as in OpenCV and ROS ``..._optical`` frames: x right, y down, z forward. The centre of
the upper left pixel is (0, 0). Quaternions are x, y, z, w.
"""

from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict
from scipy.spatial.transform import Rotation

from comotion_schemas.errors import KnownError
from comotion_schemas.types import F8Column

Vectors = NDArray[np.float64]

_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # what OpenCV accepts
_ORTHONORMAL_TOLERANCE = 1e-6  # largest entry of |R R^T - I|: six decimals in a file pass


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """Pinhole camera with the distortion model of OpenCV ("plumb_bob", "rational_polynomial" in ROS).

    Raises
    ------
    ValueError
        If a size or focal length is not above zero, a number is not finite, or OpenCV does not
        support this number of distortion coefficients.
    """

    # Image size in pixels.
    width: int
    height: int
    # Focal lengths and principal point in pixels.
    fx: float
    fy: float
    cx: float
    cy: float
    # float64 [D], D in {0, 4, 5, 8, 12, 14}: k1, k2, p1, p2, k3, ... in OpenCV's order.
    distortion: F8Column = field(default_factory=lambda: np.zeros(0))

    # In a file, a name that is none of these is an error.
    __pydantic_config__ = ConfigDict(extra="forbid")

    def __post_init__(self) -> None:
        distortion = np.array(self.distortion, np.float64).ravel()
        object.__setattr__(self, "distortion", distortion)
        if self.width < 1 or self.height < 1:
            raise KnownError(f"image size {self.width} x {self.height} is not above zero")
        numbers = np.array([self.fx, self.fy, self.cx, self.cy, *distortion])
        if not np.isfinite(numbers).all():
            raise KnownError("intrinsics must be finite")
        if self.fx <= 0 or self.fy <= 0:
            raise KnownError(f"focal lengths {self.fx}, {self.fy} are not above zero")
        if distortion.size not in _DISTORTION_LENGTHS:
            raise KnownError(f"{distortion.size} distortion coefficients; OpenCV accepts 4, 5, 8, 12 or 14")

    @property
    def matrix(self) -> Vectors:
        """Camera matrix, float64 [3, 3]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def rays(self, pixels: ArrayLike) -> Vectors:
        """Convert distorted pixels [N, 2] to rays with z = 1 in the camera frame, float64 [N, 3]."""
        distorted = np.asarray(pixels, np.float64).reshape(-1, 2)
        if self.distortion.any() and len(distorted):
            flat = cv2.undistortPoints(distorted[:, None], self.matrix, self.distortion).reshape(-1, 2)
        else:
            flat = (distorted - (self.cx, self.cy)) / (self.fx, self.fy)
        return np.column_stack([flat, np.ones(len(flat))])

    def lift(self, pixels: ArrayLike, depth: ArrayLike) -> Vectors:
        """Convert pixels [N, 2] at depth z [N] to points in the camera frame, float64 [N, 3] in metres."""
        return self.rays(pixels) * np.asarray(depth, np.float64)[:, None]

    def project(self, points: ArrayLike) -> Vectors:
        """Project points [N, 3] of the camera frame (z > 0) to distorted pixels, float64 [N, 2]."""
        positions = np.asarray(points, np.float64).reshape(-1, 3)
        if not len(positions):
            return np.empty((0, 2))
        pixels, _ = cv2.projectPoints(positions, np.zeros(3), np.zeros(3), self.matrix, self.distortion)
        return np.asarray(pixels, np.float64).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Extrinsics:
    """Pose of a camera: x_world = rotation · x_camera + translation.

    Raises
    ------
    ValueError
        If the rotation is not a proper rotation matrix, or a number is not finite.
    """

    # float64 [3, 3], orthonormal with determinant 1.
    rotation: Vectors = field(default_factory=lambda: np.eye(3))
    translation: Vectors = field(default_factory=lambda: np.zeros(3))  # float64 [3], metres
    frame: str = "world"  # name of the target frame

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, np.float64)
        translation = np.asarray(self.translation, np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise KnownError("extrinsics need a 3 x 3 rotation and a translation of 3 numbers")
        if not (np.isfinite(rotation).all() and np.isfinite(translation).all()):
            raise KnownError("extrinsics must be finite")
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if error > _ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) < 0:
            raise KnownError("the rotation is not a proper rotation matrix")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def from_quaternion(cls, quaternion: ArrayLike, translation: ArrayLike, frame: str = "world") -> Self:
        """Build from a quaternion and a translation.

        Parameters
        ----------
        quaternion
            [4], (x, y, z, w), of any norm above zero.
        translation
            [3], metres.
        frame
            Name of the target frame.

        Raises
        ------
        ValueError
            If the quaternion is zero, or a number is not finite.
        """
        values = np.asarray(quaternion, np.float64)
        if values.shape != (4,) or not np.isfinite(values).all() or np.linalg.norm(values) < 1e-9:
            raise KnownError("a quaternion is 4 finite numbers that are not all zero")
        return cls(Rotation.from_quat(values).as_matrix(), np.asarray(translation, np.float64), frame)

    @property
    def quaternion(self) -> Vectors:
        """Rotation as a unit quaternion, float64 [4] (x, y, z, w), w >= 0."""
        return np.asarray(Rotation.from_matrix(self.rotation).as_quat(canonical=True), np.float64)

    def apply(self, points: ArrayLike) -> Vectors:
        """Transform points [N, 3] from the camera frame to the target frame, float64 [N, 3]."""
        return np.asarray(points, np.float64).reshape(-1, 3) @ self.rotation.T + self.translation

    def inverse(self) -> "Extrinsics":
        """Return the transformation from the target frame to the camera."""
        return Extrinsics(self.rotation.T, -self.rotation.T @ self.translation, "camera")

    def after(self, inner: "Extrinsics") -> "Extrinsics":
        """Return the transformation that applies `inner` first, then this one."""
        return Extrinsics(
            self.rotation @ inner.rotation,
            self.rotation @ inner.translation + self.translation,
            self.frame,
        )
