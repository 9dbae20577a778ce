"""Finds new features, and tracks them from one image to the next by pyramidal Lucas-Kanade and back."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..cameras.types import Image
from .config import TrackerConfig

Pixels = NDArray[np.float32]


def track(
    earlier: Image, later: Image, pixels: Pixels, config: TrackerConfig
) -> tuple[Pixels, NDArray[np.bool_]]:
    """Track features from one grey image to the next and back.

    A feature is kept while ‖w + ŵ‖² < relative·(‖w‖² + ‖ŵ‖²) + absolute, with w = x_{t+1} − x_t and
    ŵ = x̂_t − x_{t+1} (thesis 4.2, after Sundaram, Brox and Keutzer 2010). The thesis prints this inequality
    for "stop", and x̂_t − x_t as ŵ; both are errata.

    Parameters
    ----------
    earlier, later
        uint8 [H, W], of the same size.
    pixels
        float32 [N, 2], positions in `earlier`.

    Returns
    -------
    float32 [N, 2], positions in `later`; bool [N], kept.
    """
    forward, tracked = _lucas_kanade(earlier, later, pixels, config)
    back, tracked_back = _lucas_kanade(later, earlier, forward, config)
    moved = ((forward - pixels) ** 2).sum(axis=1) + ((back - forward) ** 2).sum(axis=1)
    kept = ((back - pixels) ** 2).sum(axis=1) < config.fb_relative * moved + config.fb_absolute
    return forward, kept & tracked & tracked_back & inside(forward, later.shape, config.window // 2)


def _lucas_kanade(
    start: Image, end: Image, pixels: Pixels, config: TrackerConfig
) -> tuple[Pixels, NDArray[np.bool_]]:
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, config.iterations, config.epsilon)
    window, points = (config.window, config.window), np.ascontiguousarray(pixels[:, None])
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        start, end, points, np.empty_like(points), winSize=window, maxLevel=config.levels, criteria=criteria
    )
    positions = moved.reshape(-1, 2)
    # OpenCV leaves arbitrary numbers for a lost feature; replace them.
    tracked = (status.ravel() == 1) & np.isfinite(positions).all(axis=1)
    return np.where(tracked[:, None], positions, pixels).astype(np.float32), tracked


def inside(pixels: NDArray[Any], shape: tuple[int, ...], border: int) -> NDArray[np.bool_]:
    """Mask of pixels [N, 2] at least `border` px away from the border of an image of a shape."""
    height, width = shape[:2]
    x, y = pixels[:, 0], pixels[:, 1]
    return (x >= border) & (y >= border) & (x <= width - 1 - border) & (y <= height - 1 - border)


def new_corners(grey: Image, present: Pixels, config: TrackerConfig) -> Pixels:
    """Find corners that keep a distance from the features and from each other, float32 [M, 2], best first.

    Parameters
    ----------
    grey
        uint8 [H, W].
    present
        float32 [N, 2], existing features.
    config
        Distance and quality.
    """
    taken = np.zeros(grey.shape, np.uint8)
    for place in np.rint(present).astype(int).tolist():
        cv2.circle(taken, place, config.distance, 1, -1)
    corners = cv2.goodFeaturesToTrack(grey, 0, config.quality, config.distance)
    pixels = np.empty((0, 2), np.float32) if corners is None else corners.reshape(-1, 2)
    free = taken[tuple(pixels.astype(int).T[::-1])] == 0
    return np.asarray(pixels[free & inside(pixels, grey.shape, config.window // 2 + 1)], np.float32)
