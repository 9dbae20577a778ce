"""Takes of scenes for pictures, without processes: what a recorder would hold of them.

They are the same on every machine, however busy it is.
"""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from comotion_schemas import Message, ObservationBatch, Preview, Status, TruthBatch
from comotion_sources.frames import MessageBuilder
from comotion_sources.klt.config import TrackerConfig
from comotion_sources.proprioception.joints import JointSample
from comotion_sources.proprioception.kinematics import Kinematics
from comotion_sources.proprioception.process import Packer
from comotion_sources.streams import OFFLINE_SESSION
from comotion_sources.workcell import Scene
from comotion_sources.workcell.camera import CameraSpec

from .rendered import Filmed, filmed
from .samples import NOON_NS, at_noon, received

_SIZE = (480, 360)
_CAMERAS = {"a": (10.0, 150), "b": (5.0, 120)}
"""Rate (Hz) and features of each camera."""
_ROBOT, _ROBOT_RATE = "robot", 50.0


def workcell(name: str, seconds: float) -> list[tuple[int, Message]]:
    """A scene of the workcell, seen by both of its cameras and felt by its robot: (time in ns, message).

    Raises
    ------
    comotion_sources.cameras.types.InputError
        If MuJoCo is not installed (extra ``sim3d``).
    """
    scene = Scene(name, 0)
    messages: list[tuple[int, Message]] = [(NOON_NS, at_noon(_links(scene)))]
    given = list(_robot(scene, seconds))
    for camera, (rate, features) in _CAMERAS.items():
        source = f"klt-{camera}"
        spec = CameraSpec(scene=name, camera=camera, size=_SIZE, rate=rate, duration=seconds)
        for shot in filmed(spec, source, TrackerConfig(max_features=features)):
            preview = at_noon(_preview(source, shot))
            messages.append((preview.stamp_ns, preview))
            given += [(shot.frame.stamp_ns, message) for message in shot.messages]
    in_time_order = (message for _, message in sorted(given, key=lambda stamped: stamped[0]))
    messages += received(in_time_order, seconds)
    return sorted(messages, key=lambda stamped: stamped[0])


def _robot(scene: Scene, seconds: float) -> Iterator[tuple[int, TruthBatch | ObservationBatch]]:
    """Poses of the robot's links, with joint positions rounded to encoder counts as a robot's are."""
    kinematics = Kinematics(scene.model, scene.robot)
    packer = Packer(kinematics, rate=_ROBOT_RATE)
    builder = MessageBuilder(source=_ROBOT, session=OFFLINE_SESSION, space="world", unit="m", dim=3)
    numbers = [scene.object_of(link) for link in kinematics.links]
    ids = np.arange(len(numbers), dtype=np.uint64)
    yield 0, builder.truth(ids=ids, objects=numbers, names=scene.objects)
    for index in range(round(seconds * _ROBOT_RATE)):
        t = index / _ROBOT_RATE
        reading = JointSample(round(1e9 * t), scene.joints, scene.configuration(t))
        columns = packer.add(reading)
        if columns is not None:
            yield columns["stamp_ns"], builder.observation(**columns)


def _links(scene: Scene) -> Status:
    """What the robot says of its links."""
    names = {str(k): link for k, link in enumerate(Kinematics(scene.model, scene.robot).links)}
    nothing: dict[str, Any] = {key: {} for key in ("rates", "ages", "counters", "rejected")}
    who: dict[str, Any] = {"component": _ROBOT, "role": "source", "session": OFFLINE_SESSION}
    return Status(**who, **nothing, stamp_ns=0, state="ok", message="", feature_names=names)


def _preview(source: str, seen: Filmed) -> Preview:
    _, encoded = cv2.imencode(".jpg", seen.frame.image)
    return Preview(
        source=source,
        session=OFFLINE_SESSION,
        stamp_ns=seen.frame.stamp_ns,
        encoding="jpeg",
        image=encoded.tobytes(),
        ids=seen.tracks.ids,
        pixels=seen.tracks.pixels.astype(np.float32),
    )
