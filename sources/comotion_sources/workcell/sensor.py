"""Makes an ideal image and depth look like those of an RGB-D sensor: blur, noise and dropouts."""

import cv2
import numpy as np
from numpy.typing import NDArray

from .render import Rendering

Depth = NDArray[np.float32]

_TILE_MARGIN = 251  # noise is a random crop of tiles that are this many pixels larger than the image
_SPECKLE = 0.002  # share of depth pixels that are missing at random


# Of a structured-light RGB-D camera, the first Kinect. 1/m: the one-sigma noise of the depth is this times z²
# (Khoshelham and Elberink, Sensors 2012).
_DEPTH_NOISE = np.float32(1.425e-3)
# Share of depth pixels that are missing within so many pixels of a discontinuity; some others lie between.
_EDGE_DROPOUT, _EDGE_WIDTH = 0.6, 2
_BLUR = 0.55  # px, one sigma, of the lens
_NEAR, _FAR = 0.35, 5.0  # range of the depth, m


class Sensor:
    """Adds sensor noise; the same seed and stamp give the same noise.

    Parameters
    ----------
    shape
        (height, width) of the images.
    seed
        Seed of the noise, at least 0.
    grain
        One-sigma noise of the image, grey levels.
    """

    def __init__(self, shape: tuple[int, int], seed: int, grain: float = 1.5) -> None:
        self._shape, self._seed = shape, seed
        rng = np.random.default_rng([seed, 2])
        size = (shape[0] + _TILE_MARGIN, shape[1] + _TILE_MARGIN)
        # Depth errors of neighbouring pixels are correlated: the sensor matches blocks of pixels.
        blurred = cv2.GaussianBlur(rng.standard_normal(size).astype(np.float32), (0, 0), 0.8)
        self._depth_tile = blurred / blurred.std()
        self._image_tile = rng.normal(0.0, grain, size).astype(np.float32)
        self._chance_tile = rng.random(size, dtype=np.float32)

    def observe(self, ideal: Rendering, stamp_ns: int) -> tuple[NDArray[np.uint8], Depth]:
        """Return image uint8 [H, W, 3] and depth float32 [H, W], m (0: missing), with sensor noise."""
        rng = np.random.default_rng([self._seed, 3, stamp_ns % 2**63])
        return self._image(ideal.image, rng), self._depth(ideal.depth, rng)

    def _image(self, image: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
        soft = cv2.GaussianBlur(image, (0, 0), _BLUR)
        grain = self._cut(self._image_tile, rng)
        return np.asarray(cv2.add(soft, cv2.merge([grain] * 3), dtype=cv2.CV_8U))

    def _depth(self, depth: Depth, rng: np.random.Generator) -> Depth:
        noisy = depth + _DEPTH_NOISE * depth * depth * self._cut(self._depth_tile, rng)
        chance = self._cut(self._chance_tile, rng)
        kernel = np.ones((2 * _EDGE_WIDTH + 1,) * 2, np.uint8)
        back, front = cv2.dilate(depth, kernel), cv2.erode(depth, kernel)
        edge = back - front > 0.02 + 0.02 * depth
        # Below the share a pixel is missing; up to 0.1 above it lies between front and back.
        flying = edge & (chance < _EDGE_DROPOUT + 0.1)
        mix = front + (back - front) * self._cut(self._chance_tile, rng)
        noisy = np.where(flying, mix, noisy)
        gone = (edge & (chance < _EDGE_DROPOUT)) | (chance > 1 - _SPECKLE)
        gone |= (depth < _NEAR) | (depth > _FAR)
        return np.where(gone, np.float32(0), noisy).astype(np.float32)

    def _cut(self, tile: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        top, left = rng.integers(0, _TILE_MARGIN, 2)
        return np.ascontiguousarray(tile[top : top + self._shape[0], left : left + self._shape[1]])
