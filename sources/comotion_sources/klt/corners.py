"""Finds new features where there are none yet: Shi-Tomasi corners."""

import cv2
import numpy as np

from ..cameras.types import Image
from .config import TrackerConfig
from .flow import Pixels, inside


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
