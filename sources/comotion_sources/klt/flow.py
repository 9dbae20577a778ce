"""Tracks features from one image to the next by pyramidal Lucas-Kanade, forward and backward."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..cameras.types import Image
from .config import TrackerConfig

Pixels = NDArray[np.float32]

_MIN_EIGENVALUE = 1e-6  # keeps the division finite on a window without texture
# Converts OpenCV's residual and eigenvalue to px: measured on shifted textures of known noise, where
# windows of 11, 15 and 21 px gave 0.043, 0.050 and 0.056.
_NOISE_SCALE = 0.05


@dataclass(frozen=True, slots=True)
class Flow:
    """Result of tracking N features into the next image.

    Attributes
    ----------
    pixels
        float32 [N, 2], positions in the next image.
    noise
        float32 [N], estimated one-sigma noise of the step, px: from the residual and texture of the
        window, and from the forward-backward error.
    kept
        bool [N], found in both directions, and the two agree.
    """

    pixels: Pixels
    noise: NDArray[np.float32]
    kept: NDArray[np.bool_]


def forward_backward(
    start: Pixels, there: Pixels, back: Pixels, relative: float, absolute: float
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Forward-backward check (thesis 4.2, after Sundaram, Brox and Keutzer 2010).

    A feature is kept while ‖w + ŵ‖² < relative·(‖w‖² + ‖ŵ‖²) + absolute, with w = x_{t+1} − x_t and
    ŵ = x̂_t − x_{t+1}. The thesis prints this inequality for "stop", and x̂_t − x_t as ŵ; both are errata.

    Parameters
    ----------
    start, there, back
        float32 [N, 2], px: positions before, tracked forward, and tracked back again.
    relative
        Share of the squared motions that is allowed.
    absolute
        Constant part of the limit, px².

    Returns
    -------
    bool [N], kept; float32 [N], the error ‖w + ŵ‖ in px.
    """
    w, w_back = there - start, back - there
    error_sq = ((w + w_back) ** 2).sum(axis=1)
    allowed = relative * ((w**2).sum(axis=1) + (w_back**2).sum(axis=1)) + absolute
    return error_sq < allowed, np.sqrt(error_sq)


def track(earlier: Image, later: Image, pixels: Pixels, config: TrackerConfig) -> Flow:
    """Track features from one grey image to the next and back.

    Parameters
    ----------
    earlier, later
        uint8 [H, W], of the same size.
    pixels
        float32 [N, 2], positions in `earlier`.
    """
    if not len(pixels):
        return Flow(pixels, np.empty(0, np.float32), np.empty(0, bool))
    there, tracked, difference = _lucas_kanade(earlier, later, pixels, config)
    back, tracked_back, texture = _lucas_kanade(
        later, earlier, there, config, cv2.OPTFLOW_LK_GET_MIN_EIGENVALS
    )
    kept, error = forward_backward(pixels, there, back, config.fb_relative, config.fb_absolute)
    kept &= tracked & tracked_back & inside(there, later.shape, config.window // 2)
    # Cramér-Rao: σ = σ_image / sqrt(n λ_min), λ_min of the mean structure tensor.
    share = _NOISE_SCALE / config.window * difference / np.sqrt(np.maximum(texture, _MIN_EIGENVALUE))
    return Flow(there, np.hypot(share, error / 2).astype(np.float32), kept)


def _lucas_kanade(
    start: Image, end: Image, pixels: Pixels, config: TrackerConfig, flags: int = 0
) -> tuple[Pixels, NDArray[np.bool_], NDArray[np.float32]]:
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, config.iterations, config.epsilon)
    points = np.ascontiguousarray(pixels[:, None])
    moved, status, measure = cv2.calcOpticalFlowPyrLK(
        start,
        end,
        points,
        np.empty_like(points),
        winSize=(config.window, config.window),
        maxLevel=config.levels,
        criteria=criteria,
        flags=flags,
    )
    positions = moved.reshape(-1, 2)
    # OpenCV leaves arbitrary numbers for a lost feature; replace them.
    tracked = (status.ravel() == 1) & np.isfinite(positions).all(axis=1)
    residual = np.where(tracked, measure.ravel(), 0.0).astype(np.float32)
    return np.where(tracked[:, None], positions, pixels).astype(np.float32), tracked, residual


def inside(pixels: NDArray[Any], shape: tuple[int, ...], border: int) -> NDArray[np.bool_]:
    """Mask of pixels [N, 2] at least `border` px away from the border of an image of a shape."""
    height, width = shape[:2]
    x, y = pixels[:, 0], pixels[:, 1]
    return (x >= border) & (y >= border) & (x <= width - 1 - border) & (y <= height - 1 - border)
