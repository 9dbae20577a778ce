"""Publishes what ROS 2 messages of trackers say of features; the types come from rosbags (extra ``ros``)."""

from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from typing import Any, TypeAlias, Unpack

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.component import Where
from comotion_schemas.errors import InputError
from comotion_schemas.ros_types import from_cdr, stamp_of, topic_key
from comotion_schemas.transport import SessionSettings

from ..runtime import SourcePublisher
from ..source import Arrival

TF = "tf2_msgs/msg/TFMessage"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
POSE = "geometry_msgs/msg/PoseStamped"
CLOUD = "sensor_msgs/msg/PointCloud2"
NAMED_POSES = "motion_capture_tracking_interfaces/msg/NamedPoseArray"
KINDS = (TF, TRANSFORM, POSE, CLOUD, NAMED_POSES)
ID_FIELDS = ("id", "track_id", "marker_id", "label")
"""Fields of a point cloud that name the feature, in the order of preference."""
_LARGEST_ID = 2.0**53  # beyond, a float is no longer one whole number
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


Observed: TypeAlias = tuple[str, dict[str, Any]]
"""Features at one instant in one frame: its frame id, and what `SourcePublisher.observe` takes."""


def kind_of(key: str) -> str | None:
    """Type of the messages on a key of rmw_zenoh; None if it is not one of :data:`KINDS`."""
    chunks = key.split("/")
    names = chunks[-2].split("::") if len(chunks) > 2 else []
    if len(names) != 4:
        return None
    kind = f"{names[0]}/{names[1]}/{names[3].removesuffix('_')}"
    return kind if kind in KINDS else None


class Converter:
    """Converts messages; frames and rigid bodies get an id when their name is first seen.

    It takes frames and bodies whose names fit the `pattern`, with ``*`` and ``?``.

    Attributes
    ----------
    ids
        Ids of frames and bodies by name.
    """

    def __init__(self, pattern: str = "*") -> None:
        self._pattern = pattern
        self.ids: dict[str, int] = {}

    def convert(self, kind: str, raw: bytes, received_ns: int) -> list[Observed]:
        """Decode one message; without a stamp it has the time of its receipt.

        Raises
        ------
        InputError
            If the bytes are not a message of this type, or a cloud has no field that names features.
        """
        message = from_cdr(raw, kind)
        if kind == CLOUD:
            return [_cloud(message, received_ns)]
        poses: dict[tuple[int, str], list[tuple[int, list[float], list[float]]]] = {}
        for name, header, place, turn in _poses(kind, message):
            if fnmatchcase(name, self._pattern):
                number = self.ids.setdefault(name, len(self.ids))
                where = [place.x, place.y, place.z]
                row = (number, where, [turn.x, turn.y, turn.z, turn.w])
                poses.setdefault((stamp_of(header, received_ns), header.frame_id), []).append(row)
        return [_together(stamp, frame, rows) for (stamp, frame), rows in sorted(poses.items())]


def _poses(kind: str, message: Any) -> Iterator[tuple[str, Any, Any, Any]]:
    """Name, header, place and turn of every pose in a message."""
    if kind == POSE:
        yield "pose", message.header, message.pose.position, message.pose.orientation
    elif kind == NAMED_POSES:
        for pose in message.poses:
            yield pose.name, message.header, pose.pose.position, pose.pose.orientation
    else:
        for pose in message.transforms if kind == TF else [message]:
            yield pose.child_frame_id, pose.header, pose.transform.translation, pose.transform.rotation


def _together(stamp_ns: int, frame: str, rows: list[tuple[int, list[float], list[float]]]) -> Observed:
    """Poses of one instant; of a name that occurs twice, the last."""
    last = {number: (place, turn) for number, place, turn in rows}
    turns = np.array([turn for _, turn in last.values()], np.float64)
    lengths = np.linalg.norm(turns, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        turns = np.where(lengths[:, None] > 0.5, turns / lengths[:, None], np.nan)
    places = np.array([place for place, _ in last.values()], np.float64)
    columns = {"ids": np.array(list(last), np.uint64), "positions": places, "quaternions": turns}
    return frame, columns | {"stamp_ns": stamp_ns}


def _cloud(message: Any, received_ns: int) -> Observed:
    fields = {field.name: field for field in message.fields}
    name = next((field for field in ID_FIELDS if field in fields), None)
    if name is None or not {"x", "y", "z"} <= fields.keys():
        raise InputError(f"a cloud needs the fields x, y, z and one of {', '.join(ID_FIELDS)}")
    count = int(message.width) * int(message.height)
    data, step = np.asarray(message.data).tobytes(), int(message.point_step)
    if len(data) < count * step:
        raise InputError("a cloud is shorter than it says")
    order = ">" if message.is_bigendian else "<"
    chosen = [fields[field] for field in ("x", "y", "z", name)]
    try:
        kind = np.dtype(
            {
                "names": [field.name for field in chosen],
                "formats": [order + _NUMBERS[field.datatype] for field in chosen],
                "offsets": [field.offset for field in chosen],
                "itemsize": step,
            }
        )
    except (KeyError, ValueError):
        raise InputError("a cloud has fields that do not fit its points") from None
    points = np.frombuffer(data, kind, count)
    positions = np.stack([points[axis].astype(np.float64) for axis in "xyz"], axis=1)
    stamp_ns = stamp_of(message.header, received_ns)
    columns = {"ids": _ids(points[name]), "positions": positions, "stamp_ns": stamp_ns}
    return message.header.frame_id, columns


def _ids(numbers: NDArray[Any]) -> NDArray[np.int64]:
    """Ids from any kind of number; -1, which the publisher leaves out, for what is none."""
    values = numbers.astype(np.float64)
    with np.errstate(invalid="ignore"):
        whole = (np.abs(values) < _LARGEST_ID) & (values == np.floor(values))
    return np.where(whole, values, -1.0).astype(np.int64)


def run(
    topic: str,
    *,
    domain: int = 0,
    pattern: str = "*",
    frame: str | None = None,
    ros: SessionSettings | None = None,
    name: str = "ros2",
    space: str = "world",
    **where: Unpack[Where],
) -> None:
    """Publish the features of a topic until a signal arrives.

    Frames or bodies that fit a `pattern` with ``*`` and ``?`` are taken, in the `frame` id given, None: that
    of the first message. `ros` says how to connect to the router of the ROS network, None: that of the scene;
    `name` is that of the source, `space` that of its features.
    """
    text = f"ROS topic {topic}"
    with SourcePublisher(
        name, space=space, unit="m", dim=3, drop_invalid=True, message=text, **where
    ) as source:
        arrivals = source.receive(topic_key(topic, domain), ros)
        source.ready()
        relay(arrivals, source, Converter(pattern), frame)


def relay(
    arrivals: Iterable[Arrival | None], source: SourcePublisher, converter: Converter, frame: str | None
) -> None:
    """Convert and publish what arrives; what cannot be used is counted, and logged once."""
    for key, raw, received_ns in filter(None, arrivals):
        kind = kind_of(key)
        if kind is None:
            source.reject("schema", f"{key.split('/')[-2]} is not a type that can be followed")
            continue
        try:
            observations = converter.convert(kind, raw, received_ns)
        except InputError as error:
            source.reject("malformed", str(error))
            continue
        source.name_features({number: name for name, number in converter.ids.items()})
        for frame_id, columns in observations:
            frame = frame or frame_id
            if frame_id != frame:
                source.reject("space-mismatch", f"frame {frame_id!r} is not {frame!r}")
                continue
            try:
                source.observe(**columns)
            except ValueError as error:
                source.reject("malformed", str(error).partition("\n")[0])
