"""Cameras of a scene: their true calibration, and frames with sensor noise and truth."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Frame
from ..errors import InputError
from ..frames import AMBIGUOUS
from .atlas import Atlas
from .render import Renderer
from .scene import Scene, Vector
from .sensor import Sensor

# MuJoCo's cameras look along -z with y up, optical axes along z with y down.
_OPTICAL = np.diag([1.0, -1.0, -1.0])


def calibration(
    scene: Scene, camera: str, size: tuple[int, int] = (640, 480)
) -> tuple[Intrinsics, Extrinsics]:
    """True calibration of a camera of a scene.

    Parameters
    ----------
    scene
        The scene; its seed shifts fixed cameras by up to 4 cm per axis (seed 0: as in the file).
    camera
        Name of the camera.
    size
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
    atlas
        Textures, which the cameras of a scene may share; None: draw them.
    grain
        One-sigma noise of the image, grey levels.

    Attributes
    ----------
    intrinsics, extrinsics
        The true calibration; the extrinsics of a carried camera are those of time 0.
    carried
        Whether the camera is on a body that can move.
    objects
        Names of the true objects by number.
    """

    def __init__(
        self,
        scene: Scene,
        camera: str,
        size: tuple[int, int] = (640, 480),
        atlas: Atlas | None = None,
        grain: float = 1.5,
    ) -> None:
        self.scene = scene
        self.intrinsics, self.extrinsics = calibration(scene, camera, size)
        self.objects: Mapping[int, str] = scene.objects
        self._renderer = Renderer(scene, self.intrinsics, self.extrinsics, atlas)
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
        return Frame(stamp_ns, image, depth, _object_map(self.scene.geom_objects, ideal.geoms))

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


def _object_map(geom_objects: NDArray[np.int32], geoms: NDArray[np.int32]) -> NDArray[np.int32]:
    """Objects int32 [H, W] under geoms [H, W]; -1 on outlines, where a feature may belong to either side."""
    objects = np.where(geoms >= 0, geom_objects[geoms], AMBIGUOUS).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    uniform = cv2.erode(objects, kernel) == cv2.dilate(objects, kernel)
    return np.where(uniform, objects, AMBIGUOUS).astype(np.int32)
