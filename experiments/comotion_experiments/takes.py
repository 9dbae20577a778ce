"""Takes of scenes for pictures, without processes: what a recorder would hold of them.

They are the same on every machine, however busy it is.
"""

import cv2
import numpy as np

from comotion_schemas import Message, Preview, Status
from comotion_sources.cameras.types import Frame
from comotion_sources.klt import TrackerConfig, Tracks
from comotion_sources.proprioception import Kinematics
from comotion_sources.streams import OFFLINE_SESSION
from comotion_sources.workcell import Scene
from comotion_sources.workcell.atlas import build_atlas

from .fusion.recording import robot_messages
from .fusion.study import in_time_order
from .rendered import filmed
from .samples import received

_SIZE = (480, 360)
_CAMERAS = {"a": (10.0, 150), "b": (5.0, 120)}
"""Rate (Hz) and features of each camera."""
_ROBOT, _ROBOT_RATE = "robot", 50.0


def workcell(name: str, seconds: float) -> list[tuple[int, Message]]:
    """A scene of the workcell, seen by both of its cameras and felt by its robot: (time in ns, message).

    Raises
    ------
    comotion_sources.cameras.types.CameraError
        If MuJoCo is not installed (extra ``sim3d``).
    """
    scene = Scene.named(name, 0)
    atlas = build_atlas(scene.model, 0)
    messages: list[tuple[int, Message]] = [(0, _links(scene))]
    sources = [list(robot_messages(scene, _ROBOT_RATE, seconds))]
    for camera, (rate, features) in _CAMERAS.items():
        source = f"klt-{camera}"

        def keep(frame: Frame, tracks: Tracks, source: str = source) -> None:
            messages.append((frame.stamp_ns, _preview(source, frame, tracks)))

        tracker = TrackerConfig(max_features=features)
        seen, _ = filmed(
            scene,
            camera,
            source,
            tracker,
            size=_SIZE,
            rate=rate,
            seconds=seconds,
            atlas=atlas,
            on_frame=keep,
        )
        sources.append(seen)
    messages += received(in_time_order(sources), seconds)
    return sorted(messages, key=lambda one: one[0])


def _links(scene: Scene) -> Status:
    """What the robot says of its links."""
    return Status(
        component=_ROBOT,
        role="source",
        session=OFFLINE_SESSION,
        stamp_ns=0,
        state="ok",
        rates={},
        ages={},
        counters={},
        rejected={},
        message="",
        feature_names={str(k): link for k, link in enumerate(Kinematics(scene.model, scene.robot).links)},
    )


def _preview(source: str, frame: Frame, tracks: Tracks) -> Preview:
    _, encoded = cv2.imencode(".jpg", frame.image)
    return Preview(
        source=source,
        session=OFFLINE_SESSION,
        stamp_ns=frame.stamp_ns,
        encoding="jpeg",
        image=encoded.tobytes(),
        ids=tracks.ids,
        pixels=tracks.pixels.astype(np.float32),
    )
