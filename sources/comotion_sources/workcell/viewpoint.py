"""Cameras of a scene: their true calibration, and frames with sensor noise and truth."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

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
_PLACEMENT_M = 0.04  # largest shift of a camera per axis that a seed draws


def calibration(
    scene: Scene, camera: str, size: tuple[int, int] = (640, 480)
) -> tuple[Intrinsics, Extrinsics]:
    """True calibration of a camera of a scene.

    Parameters
    ----------
    scene
        The scene; its seed shifts the cameras by up to 4 cm per axis (seed 0: as in the file).
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
    model, index = scene.model, scene.cameras.index(camera)
    width, height = size
    focal = height / 2 / np.tan(np.deg2rad(model.cam_fovy[index]) / 2)
    intrinsics = Intrinsics(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    position = model.cam_pos[index].copy()
    if scene.seed:
        rng = np.random.default_rng([scene.seed, 4, index])
        position += rng.uniform(-_PLACEMENT_M, _PLACEMENT_M, 3)
    if _is_carried(scene, camera):
        return intrinsics, _carried_pose(scene, scene.new_data(), index)
    target = model.body_pos[model.cam_targetbodyid[index]]
    return intrinsics, _looking_at(position, target)


def _is_carried(scene: Scene, camera: str) -> bool:
    """Whether a camera is on a body that can move."""
    body = scene.model.cam_bodyid[scene.cameras.index(camera)]
    return bool(scene.model.body_weldid[body] > 0)


def _mount(scene: Scene, camera: str) -> Extrinsics:
    """Camera to the body that carries it, optical axes."""
    index = scene.cameras.index(camera)
    quaternion = scene.model.cam_quat[index][[1, 2, 3, 0]]
    turn = Rotation.from_quat(quaternion).as_matrix() @ _OPTICAL
    return Extrinsics(turn, scene.model.cam_pos[index].copy())


def _carried_pose(scene: Scene, data: Any, index: int) -> Extrinsics:
    """Pose of a carried camera in the configuration of an ``MjData``."""
    body = scene.model.cam_bodyid[index]
    carrier = Extrinsics(data.xmat[body].reshape(3, 3), data.xpos[body].copy())
    return carrier.after(_mount(scene, scene.cameras[index]))


def _looking_at(position: Vector, target: Vector) -> Extrinsics:
    """Return the extrinsics of an upright camera at `position` [3] that points at `target` [3], m."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return Extrinsics(np.stack([right, np.cross(forward, right), forward], axis=1), np.asarray(position))


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
        self._data = scene.new_data()
        self.carried = _is_carried(scene, camera)
        self._sensor = Sensor(size[::-1], 16 * scene.seed + scene.cameras.index(camera), grain)

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
        if not self.carried:
            return self.extrinsics
        self.scene.place(self._data, configuration)
        return _carried_pose(self.scene, self._data, self._camera)

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
