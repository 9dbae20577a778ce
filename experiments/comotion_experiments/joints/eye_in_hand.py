"""A camera in the hand of a robot: with the poses of the robot, and from the images alone."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from comotion import FusionConfig
from comotion_clients.metrics import Score
from comotion_schemas import HypothesisUpdate
from comotion_sources.calibration.model import Extrinsics
from comotion_sources.klt import Tracker, TrackerConfig
from comotion_sources.klt.observer import CameraSpace, Observer
from comotion_sources.poses import PoseBuffer
from comotion_sources.proprioception import JointSample, Kinematics
from comotion_sources.workcell import Scene, Viewpoint
from comotion_sources.workcell.viewpoint import mount

from ..offline import Message, run_offline
from ..rendered import keep, message_builder

SCENE, HAND, FIXED = "eye-in-hand", "hand", "a"
SIZE, RATE_HZ, SECONDS, FEATURES = (320, 240), 15.0, 10.0, 150
_ROBOT_HZ = 200.0


@dataclass(frozen=True)
class HandResult:
    """One seed: NMI of three cameras; largest errors of the camera's motion from images alone, m, degrees."""

    fixed: float
    with_poses: float
    alone: float
    shift: float
    turn: float


def run_seed(seed: int, cache: Path | None) -> HandResult:
    """Run one seed with the fixed camera, with the robot's poses, and from the images alone."""
    sources = keep(cache, f"{SCENE}-{seed}", (SIZE, RATE_HZ, SECONDS, FEATURES), lambda: _make(seed))
    scores = {
        name: run_offline(sources[name], FusionConfig()).summary.mean_nmi for name in ("fixed", "posed")
    }
    view = Viewpoint(Scene.named(SCENE, seed), HAND, SIZE)
    errors: list[tuple[float, float]] = []
    first: list[Extrinsics] = []

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        frame = next(iter(update.frames.values()), None)
        if frame is None or not isinstance(frame.rotation, list):
            return
        true = view.pose(view.scene.configuration(update.stamp_ns * 1e-9))
        first.append(true)
        moved = first[0].inverse().after(true)
        turn = Rotation.from_quat(frame.rotation).as_matrix().T @ moved.rotation
        angle = float(np.degrees(Rotation.from_matrix(turn).magnitude()))
        errors.append((float(np.linalg.norm(moved.translation - frame.translation)), angle))

    run = run_offline(sources["carried"], FusionConfig(), on_update=on_update)
    shift, turn = np.max(errors, axis=0).tolist() if errors else (np.nan, np.nan)
    return HandResult(scores["fixed"], scores["posed"], run.summary.mean_nmi, shift, turn)


def _make(seed: int) -> dict[str, list[Message]]:
    scene = Scene.named(SCENE, seed)
    hand, fixed = (Viewpoint(scene, camera, SIZE) for camera in (HAND, FIXED))
    world = CameraSpace("world", "m", 3, hand.intrinsics)
    carried = CameraSpace("hand/optical", "m", 3, hand.intrinsics)
    still = CameraSpace("world", "m", 3, fixed.intrinsics, fixed.extrinsics)
    observers = {
        "posed": Observer(world, message_builder("klt", world), scene.objects, robot_poses(scene)),
        "carried": Observer(carried, message_builder("klt", carried, moving=True), scene.objects),
    }
    found: dict[str, list[Message]] = {"posed": [], "carried": [], "fixed": []}
    for name, messages in _seen(hand, observers, moving=True):
        found[name] += messages
    for name, messages in _seen(
        fixed, {"fixed": Observer(still, message_builder("klt", still), scene.objects)}
    ):
        found[name] += messages
    return found


def _seen(
    view: Viewpoint, observers: dict[str, Observer], *, moving: bool = False
) -> Iterator[tuple[str, list[Message]]]:
    tracker = Tracker(TrackerConfig(max_features=FEATURES, moving=moving), view.intrinsics)
    for index in range(round(SECONDS * RATE_HZ)):
        frame = view.frame(view.scene.configuration(index / RATE_HZ), round(index * 1e9 / RATE_HZ))
        tracks = tracker.step(frame)
        for name, observer in observers.items():
            yield name, list(observer.messages(tracks, frame))


def robot_poses(scene: Scene) -> PoseBuffer:
    """Poses of the hand by its kinematics, from joint positions rounded to encoder counts."""
    kinematics = Kinematics(scene.model, [HAND])
    buffer = PoseBuffer(mount(scene, HAND), kept_ns=None)
    for index in range(round((SECONDS + 1) * _ROBOT_HZ)):
        stamp = round(index * 1e9 / _ROBOT_HZ)
        reading = JointSample(stamp, scene.joints, scene.configuration(index / _ROBOT_HZ))
        poses = kinematics.poses(kinematics.encoded(reading))
        buffer.add(stamp, Extrinsics.from_quaternion(poses.quaternions[0], poses.positions[0]))
    return buffer
