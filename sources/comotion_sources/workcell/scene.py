"""Moves the joints of a workcell scene by the time, and numbers its true objects.

Scenes are MJCF files with these conventions in ``<custom>``:

- ``motion:JOINT``: key-states "time value time value ...", interpolated by a monotone cubic, which does
  not overshoot. Joints without key-states stay at 0.
- ``period``: seconds after which all motion repeats (the last key-state equals the first).
- ``robot``: links whose poses proprioception reports.
- ``unscored``: bodies whose features are too ambiguous to score (turning wheels).
- ``shadow``: amplitude, radius, depth and period of a soft shadow that moves over the scene.

Joint equalities (``<equality><joint .../>``) apply: they couple wheels to the distance rolled. The
motion is a pure function of time: bodies follow their joints, not contact forces. Every process and
machine therefore computes the same configuration bit for bit.
"""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from comotion_schemas.errors import InputError

from ..streams import AMBIGUOUS

BACKGROUND = 0
"""Object number of everything that cannot move."""
STILL, MOVING = 0, 1
"""Geom groups: static geoms, and geoms that can move."""

Vector = NDArray[np.float64]

_FRAGMENTS = {"room", "clutter", "gripper", "toy_truck"}
_WARP_S = 0.35  # largest shift of the motion in time that a seed draws
_PLACEMENT_M = 0.04  # largest shift of a camera per axis that a seed draws
_MOTION = "motion:"


_FOLDER = Path(str(resources.files(__package__) / "scenes"))


def scene_names() -> list[str]:
    """List the names of the scenes in the package, sorted."""
    return sorted(p.stem for p in _FOLDER.glob("*.xml") if p.stem not in _FRAGMENTS)


def require_mujoco() -> ModuleType:
    """Import MuJoCo.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise InputError("mujoco is not installed: pip install 'comotion[sim3d]'") from None
    return mujoco  # type: ignore[no-any-return]


def couplings(model: Any) -> list[tuple[int, int, Polynomial]]:
    """List the joint equalities: (dependent joint, driving joint, position of the first by the second)."""
    kind = int(require_mujoco().mjtEq.mjEQ_JOINT)
    return [
        (int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), Polynomial(model.eq_data[i, :5]))
        for i in range(model.neq)
        if int(model.eq_type[i]) == kind and model.eq_obj2id[i] >= 0
    ]


class Scene:
    """A scene with its motion and true objects.

    Parameters
    ----------
    name
        One of :func:`scene_names`, or the path of an MJCF file that follows the conventions.
    seed
        0: as in the file. Other seeds vary the timing of the motion, shift the cameras by a few
        centimetres and draw other textures.

    Attributes
    ----------
    model
        The ``mujoco.MjModel``.
    joints
        Names of the joints, in the order of a configuration; all have one degree of freedom.
    period
        Seconds after which the motion repeats.
    objects
        Names of the true objects by number; 0 is the background.
    geom_objects, body_objects
        int32: object number of each geom and body; -1 where it is not scored.
    robot
        Links of the robot: bodies whose poses proprioception may report.
    cameras
        Names of the cameras.
    shadow
        The moving soft shadow of the clutter variants: amplitude and radius in m, share of the light that it
        takes, period in s; empty: none.

    Raises
    ------
    InputError
        If the scene is unknown or violates the conventions, or MuJoCo is not installed.
    """

    def __init__(self, name: str, seed: int = 0) -> None:
        self._mujoco = require_mujoco()
        self.name, self.seed = name, seed
        self.model = self._load(name)
        kinds = {int(self._mujoco.mjtJoint.mjJNT_HINGE), int(self._mujoco.mjtJoint.mjJNT_SLIDE)}
        if not set(self.model.jnt_type.tolist()) <= kinds:
            raise InputError(f"{self.name}: only hinge and slide joints can be driven")
        self.joints: tuple[str, ...] = tuple(self.model.joint(i).name for i in range(self.model.njnt))
        self.cameras = tuple(self.model.camera(i).name for i in range(self.model.ncam))
        self.robot = tuple(self._text("robot").split())
        self.period, *_ = self._numeric("period") or [0.0]
        self.shadow = self._numeric("shadow")
        for key in (self.model.numeric(i).name for i in range(self.model.nnumeric)):
            if key.startswith(_MOTION) and key.removeprefix(_MOTION) not in self.joints:
                raise InputError(f"{self.name}: {key}: no such joint")
        self._curves = [self._curve(_MOTION + joint) for joint in self.joints]
        self._couplings = couplings(self.model)
        # Amplitude, s, and phase of the shift of the motion in time.
        self._warp = (0.0, 0.0)
        if seed and self.period:
            rng = np.random.default_rng([seed, 1])
            self._warp = _WARP_S * rng.uniform(0.4, 1.0), rng.uniform(0, 2 * np.pi)
        self.objects, self.body_objects = self._number_objects()
        self.geom_objects = self.body_objects[self.model.geom_bodyid]
        self.model.geom_group[:] = np.where(self.model.body_weldid[self.model.geom_bodyid] > 0, MOVING, STILL)
        for camera in range(self.model.ncam) if seed else ():
            if not self.is_carried(camera):
                shift = np.random.default_rng([seed, 4, camera]).uniform(-_PLACEMENT_M, _PLACEMENT_M, 3)
                self.model.cam_pos[camera] += shift

    def is_carried(self, camera: int) -> bool:
        """Whether a camera, by its number, is on a body that can move."""
        return bool(self.model.body_weldid[self.model.cam_bodyid[camera]] > 0)

    def configuration(self, t: float) -> Vector:
        """Compute the joint positions float64 [joints], rad or m, at time t in seconds."""
        when, (amplitude, phase) = t % self.period if self.period else t, self._warp
        if amplitude:
            swing = np.sin(2 * np.pi * when / self.period + phase) - np.sin(phase)
            when = float((when + amplitude * swing) % self.period)
        q = np.array([0.0 if curve is None else float(curve(when)) for curve in self._curves])
        for target, driver, polynomial in self._couplings:
            q[target] = polynomial(q[driver])
        return q

    def place(self, data: Any, configuration: Vector) -> None:
        """Set an ``MjData`` to a configuration float64 [joints] and compute where bodies and cameras are."""
        data.qpos[:] = configuration
        self._mujoco.mj_kinematics(self.model, data)
        self._mujoco.mj_camlight(self.model, data)

    def new_data(self, configuration: Vector | None = None) -> Any:
        """Return an ``MjData`` of this scene in a configuration float64 [joints]; None: that at time 0."""
        data = self._mujoco.MjData(self.model)
        self.place(data, self.configuration(0.0) if configuration is None else configuration)
        return data

    def object_of(self, body: str) -> int:
        """Object number of a body.

        Raises
        ------
        InputError
            If the body does not exist.
        """
        try:
            return int(self.body_objects[self.model.body(body).id])
        except KeyError:
            raise InputError(f"{self.name} has no body {body!r}") from None

    def _load(self, name: str) -> Any:
        path = _FOLDER / f"{name}.xml" if name in scene_names() else Path(name)
        if not path.is_file():
            raise InputError(f"no workcell scene {name!r}; one of {', '.join(scene_names())}")
        try:
            return self._mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise InputError(f"{path}: {' '.join(str(error).split())}") from None

    def _numeric(self, name: str) -> list[float]:
        names = [self.model.numeric(i).name for i in range(self.model.nnumeric)]
        return [float(v) for v in self.model.numeric(name).data] if name in names else []

    def _text(self, name: str) -> str:
        index = self._mujoco.mj_name2id(self.model, self._mujoco.mjtObj.mjOBJ_TEXT, name)
        if index < 0:
            return ""
        start, size = int(self.model.text_adr[index]), int(self.model.text_size[index])
        return bytes(self.model.text_data[start : start + size]).rstrip(b"\0").decode()

    def _curve(self, name: str) -> PchipInterpolator | None:
        keys = np.array(self._numeric(name))
        if not keys.size:
            return None
        times, values = keys[0::2], keys[1::2]
        if len(times) != len(values) or len(times) < 2 or (np.diff(times) <= 0).any():
            raise InputError(f"{self.name}: {name}: expected 'time value' pairs with growing times")
        if times[0] != 0 or (self.period and (times[-1] != self.period or values[-1] != values[0])):
            raise InputError(f"{self.name}: {name}: must start at 0 and end at the period where it started")
        return PchipInterpolator(times, values)

    def _number_objects(self) -> tuple[Mapping[int, str], NDArray[np.int32]]:
        """Bodies with joints of their own are objects; what is fixed to one belongs to it."""
        names, numbers = {BACKGROUND: "background"}, np.zeros(self.model.nbody, np.int32)
        unscored = self._text("unscored").split()
        for body in range(1, self.model.nbody):
            name = self.model.body(body).name
            if name in unscored:
                numbers[body] = AMBIGUOUS
            elif self.model.body_jntnum[body]:
                numbers[body] = len(names)
                names[len(names)] = name
            else:
                numbers[body] = numbers[self.model.body_parentid[body]]
        return names, numbers
