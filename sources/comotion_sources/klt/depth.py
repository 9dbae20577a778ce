"""Depth of a feature: a plane through its neighbourhood, so that edges are seen and noise averages.

Over a plane the inverse depth is linear in the pixel coordinates, whatever the plane's tilt; what
departs from that is an edge, where image and depth do not agree about what is seen.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..calibration.model import Intrinsics
from .config import TrackerConfig
from .flow import Pixels

DepthImage = NDArray[np.float32]
Floats = NDArray[np.float64]

LOOKUP_RADIUS = 2
BIRTH_RADIUS = 5
_LEAST_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class DepthLookup:
    """Depth under features.

    Attributes
    ----------
    z
        float64 [N], metres, NaN where missing or at an edge.
    edge
        bool [N], there is depth, but a step in it.
    """

    z: Floats
    edge: NDArray[np.bool_]


@cache
def _offsets(radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return y.ravel(), x.ravel()


def look_up(depth: DepthImage, pixels: Pixels, config: TrackerConfig, radius: int) -> DepthLookup:
    """Depth of pixels [N, 2] by a plane over (2·radius + 1)² pixels of `depth` [H, W] (0/NaN missing)."""
    dy, dx = _offsets(radius)
    height, width = depth.shape
    near = np.rint(pixels).astype(np.int64)
    rows = np.clip(near[:, 1, None] + dy, 0, height - 1)
    columns = np.clip(near[:, 0, None] + dx, 0, width - 1)
    z = depth[rows, columns].astype(np.float64)
    valid = np.isfinite(z) & (z > 0)
    enough = valid.sum(axis=1) >= _LEAST_SHARE * dy.size
    inverse = np.divide(1.0, z, out=np.zeros_like(z), where=valid)
    # The pixel may lie half a pixel from the middle of its patch: the plane is evaluated there.
    sub = pixels.astype(np.float64) - near
    fitted, residual = _plane(inverse, valid, sub, dx, dy)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(enough & (fitted > 0), 1.0 / fitted, np.nan)
    departure = (np.abs(residual) * valid).max(axis=1, initial=0.0) * at**2  # dz = z² d(1/z)
    edge = departure > config.depth_edge + 4.0 * depth_sigma(at, config)
    return DepthLookup(np.where(edge, np.nan, at), edge)


def _plane(
    inverse: Floats, valid: NDArray[np.bool_], sub: Floats, dx: NDArray[np.int64], dy: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Fit 1/z = a + b·dx + c·dy to each patch; its value at `sub` [N] and the residuals [N, P]."""
    design = np.column_stack([np.ones(dx.size), dx, dy]).astype(np.float64)
    weights = valid.astype(np.float64)
    products = (design[:, :, None] * design[:, None, :]).reshape(dx.size, 9)
    normal = (weights @ products).reshape(-1, 3, 3) + 1e-9 * np.eye(3)
    right = (weights * inverse) @ design
    plane = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    value = plane[:, 0] + (plane[:, 1:] * sub).sum(axis=1)
    return value, inverse - plane @ design.T


def depth_sigma(z: Floats, config: TrackerConfig) -> Floats:
    """One-sigma noise of depths z [N], m: structured light and stereo err with the square of depth."""
    return np.maximum(config.depth_floor, config.depth_noise * z**2)


def point_sigma(z: Floats, pixel_sigma: Floats, intrinsics: Intrinsics, config: TrackerConfig) -> Floats:
    """Isotropic one-sigma noise of lifted points [N], m: two axes across the ray, one along it."""
    across = pixel_sigma * z * 2.0 / (intrinsics.fx + intrinsics.fy)
    along = depth_sigma(z, config)
    return np.sqrt((2.0 * across**2 + along**2) / 3.0)
