"""Parameters of the links between spaces: the calibration of plain cameras.

The numbers were chosen on seed 0 of the link experiment; docs/research/linking.md reports the others.
"""

import math
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from comotion_schemas.errors import KnownError

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=1e6)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]

_DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)  # of OpenCV's models


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
    distortion: tuple[Finite, ...] = Field(default=(), description="k1, k2, p1, p2, k3 ... as in OpenCV")
    translation: tuple[Finite, Finite, Finite] = Field(description="m; where the camera is")
    quaternion: tuple[Finite, Finite, Finite, Finite] = Field(description="x, y, z, w; camera to frame")
    frame: str = Field(default="world", description="metric space that translation and quaternion lead to")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.distortion) not in _DISTORTION_LENGTHS:
            raise KnownError(f"{len(self.distortion)} distortion coefficients; OpenCV knows 4, 5, 8, 12, 14")
        if not 1e-9 < math.hypot(*self.quaternion) < 1e9:
            raise KnownError("the quaternion is zero or beyond measure")
        return self


class LinkingConfig(BaseModel):
    """Parameters of the links between spaces."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cameras: dict[str, Camera] = Field(
        default_factory=dict,
        description="calibration of the fixed cameras behind spaces in pixels, by name of the space: "
        "their hypotheses are linked to the bodies of a metric space",
    )
    noise: Positive = Field(0.3, description="px; noise of a feature whose source does not report it")
    noise_factor: Positive = Field(
        2.0, description="noise of a position after many steps, as a multiple of the reported one of a step"
    )
    drift: Weight = Field(
        0.02, description="share of a displacement in the image by which tracking drifts and calibration errs"
    )
    outlier_share: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.2, description="share of a hypothesis' members that may be outliers"
    )
    no_body_charge: Positive = Field(
        4.0, description="charge of a feature on none of the bodies, as a multiple of the expected residual"
    )
    margin: Weight = Field(
        6.0, description="nat; by so much a body must explain the members better than all else to be linked"
    )
