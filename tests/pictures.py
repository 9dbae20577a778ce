"""Pictures whose motion is known."""

from functools import cache

import cv2
import numpy as np


@cache
def _textures(shape):
    """Two grey images of blobs, uint8: smooth, and rich in corners."""
    rng = np.random.default_rng(1)
    blobs = [cv2.GaussianBlur(rng.normal(size=shape), (0, 0), 2) for _ in range(2)]
    return [(128 + 45 * one / one.std()).clip(0, 255).astype(np.uint8) for one in blobs]


def moving_board(k, shape=(240, 320), speed=3):
    """Frame k of a board that moves to the right before a wall, BGR; and where it is, int32: 1, else 0.

    It has half of the height, 3/8 of the width, and begins at an eighth of it; speed in px per frame.
    """
    (wall, board), (height, width) = _textures(shape), shape
    rows, left, size = slice(height // 4, 3 * height // 4), width // 8 + speed * k, 3 * width // 8
    image, where = wall.copy(), np.zeros(shape, np.int32)
    image[rows, left : left + size], where[rows, left : left + size] = board[rows, :size], 1
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), where


def write_video(path, frames, rate=30.0):
    """Write images as MJPEG."""
    frames = list(frames)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), rate, frames[0].shape[1::-1])
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path
