"""Cameras of a scene: their true calibration, and frames with the noise of an RGB-D sensor, and truth."""

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Frame
from ..streams import AMBIGUOUS
from .render import Renderer, Rendering
from .scene import Scene, Vector

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
# MuJoCo's cameras look along -z with y up, optical axes along z with y down.
_OPTICAL = np.diag([1.0, -1.0, -1.0])


class Sensor:
    """Adds sensor noise; the same seed and stamp give the same noise.

    `shape` is (height, width) of the images, `grain` the one-sigma noise of the image, grey levels.
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
        soft, grain = cv2.GaussianBlur(ideal.image, (0, 0), _BLUR), self._cut(self._image_tile, rng)
        image = cv2.add(soft, cv2.merge([grain] * 3), dtype=cv2.CV_8U)
        return np.asarray(image, np.uint8), self._depth(ideal.depth, rng)

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


def calibration(
    scene: Scene, camera: str, size: tuple[int, int] = (640, 480)
) -> tuple[Intrinsics, Extrinsics]:
    """True calibration of a camera of a scene.

    The seed of the scene shifts fixed cameras by up to 4 cm per axis (seed 0: as in the file); `size` is
    (width, height) of the image in px; the vertical field of view is that of the file.

    Raises
    ------
    InputError
        If the scene has no such camera.
    """
    if camera not in scene.cameras:
        raise InputError(f"{scene.name} has no camera {camera!r}; one of {', '.join(scene.cameras)}")
    index, (width, height) = scene.cameras.index(camera), size
    focal = height / 2 / np.tan(np.deg2rad(scene.model.cam_fovy[index]) / 2)
    intrinsics = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    return intrinsics, _pose(scene, index)


def _pose(scene: Scene, index: int, configuration: Vector | None = None) -> Extrinsics:
    """Pose of a camera, by its number, in a configuration float64 [joints]; None: that at time 0."""
    data = scene.new_data(configuration)
    return Extrinsics(data.cam_xmat[index].reshape(3, 3) @ _OPTICAL, data.cam_xpos[index].copy())


class Viewpoint:
    """One simulated RGB-D camera of a scene.

    Parameters
    ----------
    scene, camera, size
        As in :func:`calibration`.
    grain
        One-sigma noise of the image, grey levels.

    Attributes
    ----------
    intrinsics, extrinsics
        The true calibration; the extrinsics of a carried camera are those of time 0.
    carried
        Whether the camera is on a body that can move.
    """

    def __init__(
        self, scene: Scene, camera: str, size: tuple[int, int] = (640, 480), grain: float = 1.5
    ) -> None:
        self.scene = scene
        self.intrinsics, self.extrinsics = calibration(scene, camera, size)
        self._renderer = Renderer(scene, self.intrinsics, self.extrinsics)
        self._camera = scene.cameras.index(camera)
        self.carried = scene.is_carried(self._camera)
        self._sensor = Sensor(size[::-1], 16 * scene.seed + self._camera, grain)

    def frame(self, configuration: Vector, stamp_ns: int) -> Frame:
        """Render the frame of a configuration float64 [joints] with a stamp.

        The same configuration and stamp give the same frame, bit for bit.
        """
        if self.carried:
            self._renderer.move(self.pose(configuration))
        ideal = self._renderer.render(configuration, stamp_ns * 1e-9)
        image, depth = self._sensor.observe(ideal, stamp_ns)
        objects = np.where(ideal.geoms >= 0, self.scene.geom_objects[ideal.geoms], AMBIGUOUS).astype(
            np.float32
        )
        # On outlines a feature may belong to either side.
        kernel = np.ones((3, 3), np.uint8)
        uniform = cv2.erode(objects, kernel) == cv2.dilate(objects, kernel)
        return Frame(stamp_ns, image, depth, np.where(uniform, objects, AMBIGUOUS).astype(np.int32))

    def pose(self, configuration: Vector) -> Extrinsics:
        """True pose of the camera in a configuration float64 [joints]."""
        return _pose(self.scene, self._camera, configuration) if self.carried else self.extrinsics

    def covered(self, stamp_ns: int) -> Frame:
        """Return the frame of a covered lens: black, without depth and objects."""
        shape = (self.intrinsics.height, self.intrinsics.width)
        return Frame(
            stamp_ns,
            np.full((*shape, 3), 4, np.uint8),
            np.zeros(shape, np.float32),
            np.full(shape, AMBIGUOUS, np.int32),
        )
