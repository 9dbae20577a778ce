"""Looks up the depth of features and its noise.

A plane is fitted to the neighbourhood of a feature, which averages noise. The inverse depth of a plane
is linear in the pixel coordinates for every tilt; a deviation from it is a depth edge, where the image
feature and the depth may belong to different surfaces.
"""

import numpy as np
from numpy.typing import NDArray

from ..calibration.model import Intrinsics
from .config import TrackerConfig
from .template import Pixels

DepthImage = NDArray[np.float32]
Floats = NDArray[np.float64]

_RADIUS = 2  # of the neighbourhood, px to each side
_MIN_VALID_SHARE = 0.5  # of the neighbourhood: fewer valid pixels do not determine a plane well
_DY, _DX = (part.ravel() for part in np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _RADIUS + 1])
_DESIGN = np.column_stack([np.ones(_DX.size), _DX, _DY])


def look_up(depth: DepthImage, pixels: Pixels, config: TrackerConfig) -> Floats:
    """Look up the depth of features by a plane fit.

    `depth` is float32 [H, W], m, 0 or NaN where missing; `pixels` are float32 [N, 2].

    Returns
    -------
    float64 [N], metres, NaN where missing or at an edge.
    """
    height, width = depth.shape
    near = np.rint(pixels).astype(np.int64)
    rows = np.clip(near[:, 1, None] + _DY, 0, height - 1)
    columns = np.clip(near[:, 0, None] + _DX, 0, width - 1)
    z = depth[rows, columns].astype(np.float64)
    valid = np.isfinite(z) & (z > 0)
    enough = valid.sum(axis=1) >= _MIN_VALID_SHARE * _DY.size
    inverse = np.divide(1.0, z, out=np.zeros_like(z), where=valid)
    # Fit 1/z = a + b·dx + c·dy to each patch.
    weights = valid.astype(np.float64)
    products = (_DESIGN[:, :, None] * _DESIGN[:, None, :]).reshape(-1, 9)
    normal = (weights @ products).reshape(-1, 3, 3) + 1e-9 * np.eye(3)
    plane = np.linalg.solve(normal, ((weights * inverse) @ _DESIGN)[:, :, None])[:, :, 0]
    residual = inverse - plane @ _DESIGN.T
    # Evaluate the plane at the exact position, up to half a pixel from the centre of the patch.
    fitted = plane[:, 0] + (plane[:, 1:] * (pixels.astype(np.float64) - near)).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(enough & (fitted > 0), 1.0 / fitted, np.nan)
    departure = (np.abs(residual) * valid).max(axis=1, initial=0.0) * at**2  # dz = z² d(1/z)
    edge = departure > config.depth_edge + 4.0 * depth_sigma(at, config)
    return np.where(edge, np.nan, at)


def depth_sigma(z: Floats, config: TrackerConfig) -> Floats:
    """One-sigma noise of depths z [N], m; that of structured light and stereo grows with z²."""
    return np.maximum(config.depth_floor, config.depth_noise * z**2)


def point_sigma(z: Floats, intrinsics: Intrinsics, config: TrackerConfig) -> Floats:
    """Isotropic one-sigma noise [N] of lifted points, m.

    Parameters
    ----------
    z
        float64 [N], depth, m.
    intrinsics, config
        Focal lengths; noise in the image and of the depth.

    Returns
    -------
    float64 [N]: root mean square over two axes across the ray and one along it.
    """
    across = config.pixel_sigma * z * 2.0 / (intrinsics.fx + intrinsics.fy)
    along = depth_sigma(z, config)
    return np.sqrt((2.0 * across**2 + along**2) / 3.0)
