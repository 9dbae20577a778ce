"""A calibrated camera that does not move, as the core knows it."""

import math
from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from ..arrays import Floats

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=1e6)]

_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # what OpenCV knows


class Camera(BaseModel):
    """Calibration of the camera behind a space in pixels: a pinhole with OpenCV's distortion.

    x_frame = R x_camera + translation, R from the quaternion (x, y, z, w); optical axes: x right,
    y down, z forward. The camera does not move.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    fx: Positive = Field(description="px; focal length")
    fy: Positive = Field(description="px; focal length")
    cx: Finite = Field(description="px; principal point")
    cy: Finite = Field(description="px; principal point")
    distortion: tuple[Finite, ...] = Field((), description="k1, k2, p1, p2, k3 ... as in OpenCV")
    translation: tuple[Finite, Finite, Finite] = Field(description="m; where the camera is")
    quaternion: tuple[Finite, Finite, Finite, Finite] = Field(description="x, y, z, w; camera to frame")
    frame: str = Field("world", description="metric space that translation and quaternion lead to")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.distortion) not in _DISTORTION_LENGTHS:
            raise ValueError(f"{len(self.distortion)} distortion coefficients; OpenCV knows 4, 5, 8, 12, 14")
        if not 1e-9 < math.hypot(*self.quaternion) < 1e9:
            raise ValueError("the quaternion is zero or beyond measure")
        if any(self.distortion):
            import cv2  # noqa: F401, PLC0415 - now, not in the midst of an update
        return self

    @property
    def focal(self) -> float:
        """Geometric mean of the focal lengths, px."""
        return math.sqrt(self.fx * self.fy)

    @property
    def rotation(self) -> Floats:
        """Camera to frame, float64 [3, 3]."""
        return np.asarray(Rotation.from_quat(self.quaternion).as_matrix())

    def normalised(self, pixels: Floats) -> Floats:
        """Undistorted image coordinates at focal length one, float64 [N, 2], of pixels [N, 2]."""
        if any(self.distortion) and len(pixels):
            import cv2  # noqa: PLC0415 - slow to import, and needed by few

            matrix = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])
            flat = cv2.undistortPoints(pixels[:, None], matrix, np.array(self.distortion))
            return np.asarray(flat.reshape(-1, 2), np.float64)
        return np.asarray((pixels - (self.cx, self.cy)) / (self.fx, self.fy), np.float64)
