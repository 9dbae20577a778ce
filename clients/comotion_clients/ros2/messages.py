"""Updates -> ROS 2 messages. Pure.

Only spaces in metres are converted: ROS has no unit for pixels. The frame id of a space is its name; the
frame of a hypothesis is ``comotion/<scene>/<id>``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Box, Hypothesis, HypothesisUpdate
from comotion_schemas.colours import BACKGROUND, Palette
from comotion_schemas.naming import Names, joint_words
from comotion_schemas.naming import named as called
from comotion_schemas.rigid import rotation, three, transform

from ..carried import poses_in_space
from ..feature_names import HypothesisNames
from .bodies import Body, bodies
from .names import topic_chunk
from .types import CLOUD, DETECTIONS, JOINTS, MARKERS, ODOMETRY, TF, make

Vector: TypeAlias = Sequence[float]

_CUBE, _TEXT, _ADD = 1, 9, 0  # visualization_msgs/Marker
_FLOAT32, _UINT32 = 7, 6  # sensor_msgs/PointField
_BOX_ALPHA = 0.25
_LIFETIMES = 3  # periods after which a marker that is not repeated disappears
_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "<u4"), ("confidence", "<f4"), ("rgb", "<u4")]
)
_NO_COVARIANCE = np.zeros(36)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class Converter:
    """Converts the updates of one scene, in order.

    Parameters
    ----------
    scene
        Its name.
    names
        Names of hypotheses by id.
    """

    def __init__(self, scene: str, names: Names | None = None) -> None:
        self._scene = scene
        self._palette = Palette()
        self.names = HypothesisNames(names)
        self._last_ns: int | None = None

    def kinds(self) -> dict[str, str]:
        """Type of each topic."""
        named = self._topic
        return {
            "/tf": TF,
            named("detections"): DETECTIONS,
            named("odometry"): ODOMETRY,
            named("features"): CLOUD,
            named("markers"): MARKERS,
            named("joints"): JOINTS,
        }

    def convert(self, update: HypothesisUpdate) -> Iterator[tuple[str, str, Any]]:
        """Yield topic, type and message; nothing for an update that repeats a stamp or has none."""
        self._palette.see(update.hypotheses)
        self.names.on_update(update)
        if update.stamp_ns <= 0 or update.stamp_ns == self._last_ns:
            return
        self._last_ns, update = update.stamp_ns, poses_in_space(update)
        tracks = _tracks_by_space(update)
        placed = bodies(update.hypotheses, set(tracks))
        named = self._topic
        for space, rows in tracks.items():
            here = [body for body in placed if body.hypothesis.space == space]
            yield named("features"), CLOUD, self._cloud(update, space, rows)
            yield named("detections"), DETECTIONS, self._detections(update, space, here)
            yield named("markers"), MARKERS, self._markers(update, here)
        for body in placed:
            yield named("odometry"), ODOMETRY, self._odometry(update, body)
        if placed:
            yield "/tf", TF, make(TF)(transforms=list(self._transforms(update, placed)))
        if any(joint.position is not None for joint in update.joints):
            yield named("joints"), JOINTS, self._joints(update)

    def _topic(self, name: str) -> str:
        return f"/comotion/{topic_chunk(self._scene)}/{name}"

    def _frame(self, hypothesis: int) -> str:
        return f"comotion/{self._scene}/{hypothesis}"

    def _cloud(self, update: HypothesisUpdate, space: str, rows: NDArray[np.intp]) -> Any:
        points = np.empty(len(rows), _POINT)
        points["x"], points["y"], points["z"] = update.track_position[rows].T
        points["label"], points["confidence"] = update.track_hypothesis[rows], update.track_confidence[rows]
        # Bytes of the number: blue, green, red, nothing.
        shades = self._palette.colours(update.track_hypothesis[rows]).astype(np.uint32)
        points["rgb"] = shades @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        field = make("sensor_msgs/PointField")
        fields = [
            field(
                name=name,
                offset=int(_POINT.fields[name][1]),  # type: ignore[index]
                datatype=_UINT32 if name in {"label", "rgb"} else _FLOAT32,
                count=1,
            )
            for name in _POINT.names or ()
        ]
        return make(CLOUD)(
            header=_header(update, space),
            height=1,
            width=len(rows),
            fields=fields,
            is_bigendian=False,
            point_step=_POINT.itemsize,
            row_step=_POINT.itemsize * len(rows),
            data=points.view(np.uint8).reshape(-1),
            is_dense=True,
        )

    def _transforms(self, update: HypothesisUpdate, placed: Sequence[Body]) -> Iterator[Any]:
        """Yield the frames of bodies, and the world in the frame of every space that moves.

        The world is the child: the frame of a space may already have a parent in the ROS network.
        """
        for body in placed:
            space, child = body.hypothesis.space, self._frame(body.hypothesis.id)
            yield _transform(update, space, child, body.origin, body.quaternion)
        for space in {body.hypothesis.space for body in placed} & update.frames.keys():
            place, turn = transform(update.frames[space]).inv().as_components()
            child = f"comotion/{self._scene}/{space}/world"
            yield _transform(update, space, child, place.tolist(), turn.as_quat().tolist())

    def _odometry(self, update: HypothesisUpdate, body: Body) -> Any:
        twist = make("geometry_msgs/Twist")(linear=_vector(body.linear), angular=_vector(body.angular))
        return make(ODOMETRY)(
            header=_header(update, body.hypothesis.space),
            child_frame_id=self._frame(body.hypothesis.id),
            pose=make("geometry_msgs/PoseWithCovariance")(
                pose=_pose(body.origin, body.quaternion), covariance=_NO_COVARIANCE
            ),
            twist=make("geometry_msgs/TwistWithCovariance")(twist=twist, covariance=_NO_COVARIANCE),
        )

    def _detections(self, update: HypothesisUpdate, space: str, placed: Sequence[Body]) -> Any:
        return make(DETECTIONS)(
            header=_header(update, space), detections=[_detection(update, body) for body in placed]
        )

    def _markers(self, update: HypothesisUpdate, placed: Sequence[Body]) -> Any:
        markers = []
        words = {joint.child: joint_words(joint, self.names) for joint in update.joints if joint.point}
        for body in placed:
            hypothesis, rgb = body.hypothesis, self._palette.colour(body.hypothesis.id)
            if hypothesis.box is not None and hypothesis.state != "static" and rgb != BACKGROUND:
                centre, turn, size = _box(hypothesis.box)
                look = _Look(_CUBE, _pose(centre, turn), size, rgb, _BOX_ALPHA)
                markers.append(_marker(update, hypothesis, "box", look))
            letters = 0.05 if hypothesis.box is None else 0.02 + 0.3 * min(hypothesis.box.half)
            pose = _pose(body.origin, _UPRIGHT)
            look = _Look(
                _TEXT,
                pose,
                (0.0, 0.0, letters),
                rgb,
                text=words.get(hypothesis.id, called(hypothesis.id, self.names)),
            )
            markers.append(_marker(update, hypothesis, "id", look))
        return make(MARKERS)(markers=markers)

    def _joints(self, update: HypothesisUpdate) -> Any:
        known = [joint for joint in update.joints if joint.position is not None]
        return make(JOINTS)(
            header=_header(update, ""),
            name=[f"comotion/{self._scene}/{joint.parent}-{joint.child}" for joint in known],
            position=np.array([joint.position for joint in known], np.float64),
            velocity=np.array([joint.rate or 0.0 for joint in known], np.float64),
            effort=np.empty(0),
        )


def _transform(update: HypothesisUpdate, parent: str, child: str, place: Vector, turn: Vector) -> Any:
    return make("geometry_msgs/TransformStamped")(
        header=_header(update, parent),
        child_frame_id=child,
        transform=make("geometry_msgs/Transform")(translation=_vector(place), rotation=_quaternion(turn)),
    )


def _tracks_by_space(update: HypothesisUpdate) -> dict[str, NDArray[np.intp]]:
    """Rows of the tracks of each space in metres; undetermined ones are in the space of their source."""
    dims = {h.id: (h.space, len(h.centroid)) for h in update.hypotheses}
    rows_by_space: dict[str, list[NDArray[np.intp]]] = {}
    for number in range(len(update.sources)):
        rows = np.flatnonzero(update.track_source == number)
        labels = np.unique(update.track_hypothesis[rows]).tolist()
        spaces = [dims[label][0] for label in labels if label in dims]
        # The update has no units: spaces with two coordinates are in pixels by default.
        if spaces and not np.isnan(update.track_position[rows, 2]).any():
            rows_by_space.setdefault(spaces[0], []).append(rows)
    return {space: np.concatenate(rows) for space, rows in sorted(rows_by_space.items())}


def _detection(update: HypothesisUpdate, body: Body) -> Any:
    hypothesis = body.hypothesis
    confidence = update.track_confidence[update.track_hypothesis == hypothesis.id]
    result = make("vision_msgs/ObjectHypothesisWithPose")(
        hypothesis=make("vision_msgs/ObjectHypothesis")(
            class_id=hypothesis.state, score=float(confidence.mean()) if len(confidence) else 0.0
        ),
        pose=make("geometry_msgs/PoseWithCovariance")(
            pose=_pose(body.origin, body.quaternion), covariance=_NO_COVARIANCE
        ),
    )
    centre, turn, size = (
        (body.origin, body.quaternion, (0.0, 0.0, 0.0)) if hypothesis.box is None else _box(hypothesis.box)
    )
    return make("vision_msgs/Detection3D")(
        header=_header(update, hypothesis.space),
        results=[result],
        bbox=make("vision_msgs/BoundingBox3D")(center=_pose(centre, turn), size=_vector(size)),
        id=str(hypothesis.id),
    )


def _box(box: Box) -> tuple[Vector, Vector, Vector]:
    """Centre, quaternion and size of a box; flat in 2-D."""
    return (
        three(box.center).tolist(),
        rotation(box.rotation).as_quat().tolist(),
        (2 * three(box.half)).tolist(),
    )


@dataclass(frozen=True)
class _Look:
    """How a marker looks: its kind, place, size in m, colour and opacity, and text."""

    kind: int
    pose: Any
    size: Vector
    rgb: tuple[int, int, int]
    alpha: float = 1.0
    text: str = ""


def _marker(update: HypothesisUpdate, hypothesis: Hypothesis, namespace: str, look: _Look) -> Any:
    red, green, blue = (value / 255 for value in look.rgb)
    seconds, nanoseconds = divmod(_LIFETIMES * update.period_ns, 1_000_000_000)
    duration, colour = make("builtin_interfaces/Duration"), make("std_msgs/ColorRGBA")
    mesh, image = make("visualization_msgs/MeshFile"), make("sensor_msgs/CompressedImage")
    empty = np.empty(0, np.uint8)
    return make("visualization_msgs/Marker")(
        header=_header(update, hypothesis.space),
        ns=namespace,
        id=hypothesis.id & 0x7FFFFFFF,
        type=look.kind,
        action=_ADD,
        pose=look.pose,
        scale=_vector(look.size),
        color=colour(r=red, g=green, b=blue, a=look.alpha),
        lifetime=duration(sec=seconds, nanosec=nanoseconds),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=image(header=_header(update, ""), format="", data=empty),
        uv_coordinates=[],
        text=look.text,
        mesh_resource="",
        mesh_file=mesh(filename="", data=empty),
        mesh_use_embedded_materials=False,
    )


def _header(update: HypothesisUpdate, frame: str) -> Any:
    seconds, nanoseconds = divmod(update.stamp_ns, 1_000_000_000)
    stamp = make("builtin_interfaces/Time")(sec=seconds, nanosec=nanoseconds)
    return make("std_msgs/Header")(stamp=stamp, frame_id=frame)


def _vector(values: Vector) -> Any:
    x, y, z = values
    return make("geometry_msgs/Vector3")(x=x, y=y, z=z)


def _quaternion(values: Vector) -> Any:
    x, y, z, w = values
    return make("geometry_msgs/Quaternion")(x=x, y=y, z=z, w=w)


def _pose(place: Vector, turn: Vector) -> Any:
    x, y, z = place
    point = make("geometry_msgs/Point")(x=x, y=y, z=z)
    return make("geometry_msgs/Pose")(position=point, orientation=_quaternion(turn))
