"""The camera ``workcell:SCENE/CAMERA``, rendered as the scene moves.

The camera has two modes with the same renderer:

- Attached to a Zenoh session, it follows the joint states that ``comotion source workcell`` publishes
  (all joints of the scene, so all bodies). Each frame shows the configuration interpolated at its
  stamp. While no joint states arrive the camera waits.
- Not attached, it plays the motion of the scene: frames k / rate seconds after 0, for one period or the
  given duration. The frames are the same each time, bit for bit.

In both modes the time of the scene is the stamp modulo the period.
"""

import logging
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast
from urllib.parse import parse_qsl

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass

from comotion_schemas import JointStates
from comotion_schemas.component import Component
from comotion_schemas.errors import InputError, KnownError, describe
from comotion_schemas.types import Name

from ..cameras.tum import write_folder
from ..cameras.types import Camera, Frame
from ..poses import Timed
from ..source import Received
from .scene import Scene, Vector
from .viewpoint import Viewpoint

PREFIX = "workcell:"
DEFAULT_FEED = "workcell"
_WARN_AFTER_S = 2.0  # without joint states
_KEPT_NS = 2_000_000_000  # a camera renders at most this far behind the joint states
_GAP_NS = 500_000_000  # longer gaps are not interpolated
_WAIT_S = 0.1  # between two looks at whether the camera is closed
_log = logging.getLogger(__name__)


def _split(at: str, value: Any) -> Any:
    return tuple(value.split(at)) if isinstance(value, str) else value


def _ordered(cover: tuple[float, float]) -> tuple[float, float]:
    if cover[0] >= cover[1]:
        raise KnownError("the end is not after the start")
    return cover


_Edge = Annotated[int, Field(ge=16, le=4096)]
_Time = Annotated[float, Field(ge=0, lt=1e6)]
_Positive = Annotated[float, Field(gt=0, lt=1e6)]
_Cover = Annotated[tuple[_Time, _Time], BeforeValidator(partial(_split, "-")), AfterValidator(_ordered)]


@dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
class CameraSpec:
    """A parsed ``workcell:SCENE/CAMERA?option=value&...``."""

    # Names of the scene and of one of its cameras.
    scene: str
    camera: str
    # Width and height of the image in pixels.
    size: Annotated[tuple[_Edge, _Edge], BeforeValidator(partial(_split, "x"))] = (640, 480)
    rate: _Positive = 30.0  # frames per second
    # Seed of the scene; it must equal that of the process that drives the scene.
    seed: Annotated[int, Field(ge=0)] = 0
    cover: _Cover | None = None  # from and to when the lens is covered, s of the scene; None: never
    # Seconds until the stream ends; None: one period, or no end when attached.
    duration: _Positive | None = None
    follow: Name = DEFAULT_FEED  # name of the joint states to follow when attached


def parse(text: str) -> CameraSpec:
    """Parse the name of a camera, with or without ``workcell:``.

    Raises
    ------
    InputError
        If the name is malformed.

    Examples
    --------
    >>> parse("workcell:truck/a?size=320x240&rate=15").size
    (320, 240)
    """
    path, _, query = text.removeprefix(PREFIX).partition("?")
    scene, slash, camera = path.partition("/")
    if not (scene and slash and camera):
        raise InputError(f"{text}: expected workcell:SCENE/CAMERA, such as workcell:truck/a")
    options: dict[str, Any] = dict(parse_qsl(query, keep_blank_values=True))
    if twice := options.keys() & {"scene", "camera"}:
        raise InputError(f"{text}: {min(twice)} is not an option, it stands before the '?'")
    try:
        return CameraSpec(scene=scene, camera=camera, **options)
    except ValidationError as error:
        raise InputError(f"{text}: {describe(error)}") from None


class WorkcellCamera(Camera):
    """A simulated RGB-D camera, by its name as in :func:`parse` or by what that says.

    Raises
    ------
    InputError
        If the name is malformed, the scene or camera does not exist, or MuJoCo is not installed.
    """

    def __init__(self, spec: CameraSpec | str) -> None:
        self.spec = spec = parse(spec) if isinstance(spec, str) else spec
        self.scene = Scene(spec.scene, spec.seed)
        self.viewpoint = Viewpoint(self.scene, spec.camera, spec.size)
        super().__init__(spec.rate)
        self.has_depth = True
        self.intrinsics = self.viewpoint.intrinsics
        # That of a carried camera changes.
        self.extrinsics = None if self.viewpoint.carried else self.viewpoint.extrinsics
        self.objects = self.scene.objects
        self.counters["skipped"] = 0
        self._states = Timed[Vector](lambda a, b, share: a + share * (b - a), _KEPT_NS, _GAP_NS)
        self._session = ""
        # A joint that the last message lacked.
        self._missing: str | None = None
        self._inbox: Received | None = None

    def attach(self, component: Component) -> None:
        """Follow the joint states of a scene."""
        self.live = True
        key = component.keys.stream("joints", self.spec.follow)
        self._inbox = Received(component.session, key, "joints")

    def _read(self) -> Iterator[Frame]:
        if self.live:
            yield from self._follow()
            return
        for index in range(round((self.spec.duration or self.scene.period) * self.spec.rate)):
            t = index / self.spec.rate
            yield self._frame(self.scene.configuration(t), round(t * 1e9))

    def _follow(self) -> Iterator[Frame]:
        """Yield frames at multiples of the period on the wall clock; skip those that are late."""
        period_ns = round(1e9 / self.spec.rate)
        index = time.time_ns() // period_ns + 1
        last = None if self.spec.duration is None else index + round(self.spec.duration * self.spec.rate)
        while not self.closed.is_set() and (last is None or index < last):
            stamp = index * period_ns
            state = self._await(stamp)
            if state is not None:
                yield self._frame(state, stamp)
            due = max(index + 1, time.time_ns() // period_ns)
            self.counters["skipped"] += due - index - 1
            index = due

    def _frame(self, configuration: Vector, stamp_ns: int) -> Frame:
        cover = self.spec.cover
        if cover is not None and cover[0] <= stamp_ns * 1e-9 % self.scene.period < cover[1]:
            return self.viewpoint.covered(stamp_ns)
        return self.viewpoint.frame(configuration, stamp_ns)

    def _await(self, stamp_ns: int) -> Vector | None:
        """Wait for the joint states around a stamp; None if they are missing, or at the end."""
        warn_at, warned = time.monotonic() + _WARN_AFTER_S, False
        while not self.closed.is_set() and (inbox := self._inbox) is not None:
            for message in inbox.messages():
                self._take(cast("JointStates", message))
            newest = self._states.newest_ns
            if newest is not None and newest >= stamp_ns:
                if warned:
                    _log.warning("joint states %r arrive", self.spec.follow)
                return self._states.at(stamp_ns)
            if not warned and time.monotonic() > warn_at:
                warned, name = True, self.spec.follow
                text = f"waiting for joint states {name!r} (comotion source workcell {self.spec.scene})"
                if self._missing is not None:
                    text = f"joint states {name!r} have no {self._missing!r}: another scene?"
                _log.warning("%s", text)
            inbox.wait(_WAIT_S)
        return None

    def _take(self, message: JointStates) -> None:
        """Add a configuration; a new session discards the states of the old one."""
        if message.session != self._session:
            self._session = message.session
            self._states.clear()
        positions = dict(zip(message.names, message.positions.tolist(), strict=True))
        self._missing = next((joint for joint in self.scene.joints if joint not in positions), None)
        if self._missing is None:
            self._states.add(message.stamp_ns, np.array([positions[joint] for joint in self.scene.joints]))


def write_tum(camera: WorkcellCamera, folder: Path) -> int:
    """Write all frames of an unattached camera as a TUM RGB-D folder, with truth; returns their number.

    Raises
    ------
    InputError
        If the folder exists and is not empty.
    OSError
        If it cannot be written.
    """
    scene, viewpoint = camera.scene, camera.viewpoint
    poses = ((frame, viewpoint.pose(scene.configuration(frame.stamp_ns * 1e-9))) for frame in camera)
    return write_folder(folder, poses, camera.intrinsics, camera.objects)
