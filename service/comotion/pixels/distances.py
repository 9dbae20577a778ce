"""Measures how far apart trajectories are in the image, and in place and motion, on key frames."""

import numpy as np

from ..arrays import Floats32
from .key_frames import KeyFrames

# px of distance in the image that a px of difference in displacement counts for.
_MOTION_WEIGHT = np.float32(10)


def distances(frames: KeyFrames) -> tuple[Floats32, Floats32]:
    """How far apart all pairs of N trajectories are in the image, and in place and motion, px [N, N] each.

    The former is the root mean square over key frames; the latter that, plus ten times that of displacements,
    over the root of the share of frames that both are seen in. They are inf without two common frames.
    """
    seen = frames.visible.astype(np.float32)
    image, common = _root_mean_square(frames.positions, seen)
    moved = frames.positions[1:] - frames.positions[:-1]
    local, _ = _root_mean_square(moved, seen[1:] * seen[:-1])
    local *= _MOTION_WEIGHT
    local += image
    local /= np.sqrt(np.maximum(common, 1) / np.float32(len(seen)))
    for distance in (image, local):
        distance[common < 2] = np.inf
    return image, local


def _root_mean_square(values: Floats32, seen: Floats32) -> tuple[Floats32, Floats32]:
    """Of the differences of values [F, N, 2] over common frames, and the number of these, [N, N]."""
    weight = seen[..., None]
    # Shifting by the frame's mean keeps the difference of large squares accurate in float32.
    mean = (values * weight).sum(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1)
    x, y = np.moveaxis((values - mean) * weight, 2, 0)
    square = x * x + y * y
    # |a - b|² = |a|² + |b|² - 2 ab, all in one product.
    total = np.concatenate([-2 * x, -2 * y, square, seen]).T @ np.concatenate([x, y, seen, square])
    common = seen.T @ seen
    np.maximum(total, 0, out=total)
    total /= np.maximum(common, 1)
    return np.sqrt(total, out=total), common
