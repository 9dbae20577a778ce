"""Converts updates to ROS 2 messages. Pure.

Only spaces in metres are converted: ROS has no unit for pixels. The frame id of a space is its name; the
frame of a hypothesis is ``comotion/<scene>/<id>``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Box, Hypothesis, HypothesisUpdate
from comotion_schemas.colours import BACKGROUND, Palette
from comotion_schemas.naming import Names, joint_words
from comotion_schemas.naming import named as called
from comotion_schemas.rigid import rotation, spin, three, transform

from ..bodies import HypothesisNames, poses_in_space
from ..scoring import UNKNOWN, spaces_of
from .types import CLOUD, DETECTIONS, JOINTS, MARKERS, ODOMETRY, TF, topic_chunk


@dataclass(frozen=True)
class Body:
    """The frame of one hypothesis in its space.

    The origin is the middle of its box, or its centroid without one; the axes are those of the space at its
    birth, turned with the body.
    """

    hypothesis: Hypothesis
    # In m, and (x, y, z, w).
    origin: Sequence[float]
    quaternion: Sequence[float]
    # m/s of the origin and rad/s, in the axes of the frame; zero where unknown.
    linear: Sequence[float] = (0.0, 0.0, 0.0)
    angular: Sequence[float] = (0.0, 0.0, 0.0)


def frame_of(hypothesis: Hypothesis) -> Body:
    """Frame of a hypothesis; in 2-D, in the plane z = 0."""
    centroid, box, twist = three(hypothesis.centroid), hypothesis.box, hypothesis.twist
    origin = centroid if box is None else three(box.center)
    turn = rotation(0.0 if hypothesis.pose is None else hypothesis.pose.rotation)
    placed = Body(hypothesis, origin.tolist(), turn.as_quat().tolist())
    if twist is None:
        return placed
    back, about = turn.inv(), spin(twist)
    moved = three(twist.linear) + np.cross(about, origin - centroid)
    return replace(placed, linear=back.apply(moved).tolist(), angular=back.apply(about).tolist())


Vector: TypeAlias = Sequence[float]
Fields: TypeAlias = dict[str, Any]
"""Fields of a message, as :func:`.types.to_cdr` takes them."""
_KINDS = {"/tf": TF, "detections": DETECTIONS, "odometry": ODOMETRY}
_KINDS |= {"features": CLOUD, "markers": MARKERS, "joints": JOINTS}
_CUBE, _TEXT = 1, 9  # visualization_msgs/Marker
_FLOAT32, _UINT32 = 7, 6  # sensor_msgs/PointField
_MOST_SECONDS = 2**31 - 1  # builtin_interfaces/Time
_BOX_ALPHA = 0.25
_LIFETIMES = 3  # periods after which a marker that is not repeated disappears
_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "<u4"), ("confidence", "<f4"), ("rgb", "<u4")]
)
_FIELDS = [
    (name, _POINT.fields[name][1], _UINT32 if name in {"label", "rgb"} else _FLOAT32, 1)  # type: ignore[index]
    for name in _POINT.names or ()
]
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Converter:
    """Converts the updates of one scene, in order; `names` of hypotheses by id."""

    def __init__(self, scene: str, names: Names | None = None) -> None:
        self._scene = scene
        self._palette = Palette()
        self.names = HypothesisNames(names)
        self._last_ns: int | None = None

    def kinds(self) -> dict[str, str]:
        """Type of each topic."""
        return {self._topic(name): kind for name, kind in _KINDS.items()}

    def convert(self, update: HypothesisUpdate) -> Iterator[tuple[str, str, Fields]]:
        """Yield topic, type and fields of messages; none for an update that repeats a stamp or has none."""
        self._palette.see(update.hypotheses)
        self.names.on_update(update)
        if update.stamp_ns <= 0 or update.stamp_ns == self._last_ns:
            return
        self._last_ns, update = update.stamp_ns, poses_in_space(update)
        for name, fields in self._messages(update):
            yield self._topic(name), _KINDS[name], fields

    def _messages(self, update: HypothesisUpdate) -> Iterator[tuple[str, Fields]]:
        tracks = _tracks_by_space(update)
        bodies = [frame_of(h) for h in update.hypotheses if h.space in tracks and not h.absent]
        for space, rows in tracks.items():
            of_space = [body for body in bodies if body.hypothesis.space == space]
            detections = [_detection(update, body) for body in of_space]
            yield "features", self._cloud(update, space, rows)
            yield "detections", {"header": _header(update, space), "detections": detections}
            yield "markers", self._markers(update, of_space)
        for body in bodies:
            yield "odometry", self._odometry(update, body)
        if bodies:
            yield "/tf", {"transforms": list(self._transforms(update, bodies))}
        if any(joint.position is not None for joint in update.joints):
            yield "joints", self._joints(update)

    def _topic(self, name: str) -> str:
        return name if name == "/tf" else f"/comotion/{topic_chunk(self._scene)}/{name}"

    def _frame(self, hypothesis: int) -> str:
        return f"comotion/{self._scene}/{hypothesis}"

    def _cloud(self, update: HypothesisUpdate, space: str, rows: NDArray[np.intp]) -> Fields:
        points = np.empty(len(rows), _POINT)
        points["x"], points["y"], points["z"] = update.track_position[rows].T
        points["label"], points["confidence"] = update.track_hypothesis[rows], update.track_confidence[rows]
        # Bytes of the number: blue, green, red, nothing.
        shades = self._palette.colours(update.track_hypothesis[rows]).astype(np.uint32)
        points["rgb"] = shades @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        return {
            "header": _header(update, space),
            "height": 1,
            "width": len(rows),
            "fields": _FIELDS,
            "point_step": _POINT.itemsize,
            "row_step": _POINT.itemsize * len(rows),
            "data": points.view(np.uint8).reshape(-1),
            "is_dense": True,
        }

    def _transforms(self, update: HypothesisUpdate, placed: Sequence[Body]) -> Iterator[Fields]:
        """Yield the frames of bodies, and the world in the frame of every space that moves.

        The world is the child: the frame of a space may already have a parent in the ROS network.
        """
        frames: list[tuple[str, str, Vector, Vector]] = [
            (b.hypothesis.space, self._frame(b.hypothesis.id), b.origin, b.quaternion) for b in placed
        ]
        for space in {body.hypothesis.space for body in placed} & update.frames.keys():
            place, turn = transform(update.frames[space]).inv().as_components()
            child = f"comotion/{self._scene}/{space}/world"
            frames.append((space, child, place.tolist(), turn.as_quat().tolist()))
        for space, child, *pose in frames:
            yield {"header": _header(update, space), "child_frame_id": child, "transform": pose}

    def _odometry(self, update: HypothesisUpdate, body: Body) -> Fields:
        return {
            "header": _header(update, body.hypothesis.space),
            "child_frame_id": self._frame(body.hypothesis.id),
            "pose": {"pose": (body.origin, body.quaternion)},
            "twist": {"twist": (body.linear, body.angular)},
        }

    def _markers(self, update: HypothesisUpdate, placed: Sequence[Body]) -> Fields:
        markers: list[Fields] = []
        words = {joint.child: joint_words(joint, self.names) for joint in update.joints if joint.point}
        for body in placed:
            hypothesis, box = body.hypothesis, body.hypothesis.box
            rgb = self._palette.colour(hypothesis.id)
            colour = [value / 255 for value in rgb]
            marker = {
                "header": _header(update, hypothesis.space),
                "id": hypothesis.id & 0x7FFFFFFF,
                "lifetime": _time(_LIFETIMES * update.period_ns),
            }
            if box is not None and hypothesis.state != "static" and rgb != BACKGROUND:
                centre, turn, size = _box(box)
                look = {"pose": (centre, turn), "scale": size, "color": (*colour, _BOX_ALPHA)}
                markers.append({**marker, **look, "ns": "box", "type": _CUBE})
            letters = 0.05 if box is None else 0.02 + 0.3 * min(box.half)
            look = {"pose": (body.origin, _UPRIGHT), "scale": (0.0, 0.0, letters), "color": (*colour, 1.0)}
            text = words.get(hypothesis.id, called(hypothesis.id, self.names))
            markers.append({**marker, **look, "ns": "id", "type": _TEXT, "text": text})
        return {"markers": markers}

    def _joints(self, update: HypothesisUpdate) -> Fields:
        placed = [joint for joint in update.joints if joint.position is not None]
        return {
            "header": _header(update, ""),
            "name": [f"comotion/{self._scene}/{joint.parent}-{joint.child}" for joint in placed],
            "position": [joint.position for joint in placed],
            "velocity": [joint.rate or 0.0 for joint in placed],
        }


def _tracks_by_space(update: HypothesisUpdate) -> dict[str, NDArray[np.intp]]:
    """Rows of the tracks of each space in metres; undetermined ones are in the space of their source."""
    spaces = spaces_of(update)
    return {
        space.name: np.flatnonzero([spaces[source] == space for source in update.track_source.tolist()])
        for space in sorted(set(spaces), key=lambda space: space.name)
        if space.unit == "m" and space.name != UNKNOWN
    }


def _detection(update: HypothesisUpdate, body: Body) -> Fields:
    hypothesis, pose = body.hypothesis, (body.origin, body.quaternion)
    confidence = update.track_confidence[update.track_hypothesis == hypothesis.id]
    score = float(confidence.mean()) if len(confidence) else 0.0
    centre, turn, size = (*pose, ()) if hypothesis.box is None else _box(hypothesis.box)
    return {
        "header": _header(update, hypothesis.space),
        "results": [((hypothesis.state, score), {"pose": pose})],
        "bbox": ((centre, turn), size),
        "id": str(hypothesis.id),
    }


def _box(box: Box) -> tuple[Vector, Vector, Vector]:
    """Centre, quaternion and size of a box; flat in 2-D."""
    centre, half = three(box.center), three(box.half)
    return centre.tolist(), rotation(box.rotation).as_quat().tolist(), (2 * half).tolist()


def _header(update: HypothesisUpdate, frame: str) -> Fields:
    return {"stamp": _time(update.stamp_ns), "frame_id": frame}


def _time(ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds; times that ROS cannot say, from 2038 on, are the last that it can."""
    seconds, nanoseconds = divmod(ns, 1_000_000_000)
    return min(seconds, _MOST_SECONDS), nanoseconds
