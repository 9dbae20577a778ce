"""ROS 2 message types, their hashes, messages of plain values and CDR, by rosbags (extra ``ros``)."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from comotion_schemas.ros_types import store

TF = "tf2_msgs/msg/TFMessage"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
ODOMETRY = "nav_msgs/msg/Odometry"
CLOUD = "sensor_msgs/msg/PointCloud2"
MARKERS = "visualization_msgs/msg/MarkerArray"
JOINTS = "sensor_msgs/msg/JointState"
# How rosbags marks the field of a type: a number or text, a message; others are arrays of one of both.
_BASE, _MESSAGE = 1, 2


@cache
def type_hash(name: str) -> str:
    """Hash of a message type, ``RIHS01_...``."""
    return str(store().hash_rihs01(name))


@cache
def definition(name: str) -> str:
    """Text of a message type with all types that it contains."""
    return str(store().generate_msgdef(name, ros_version=2)[0])


def to_cdr(values: Mapping[str, Any], name: str) -> bytes:
    """Encode a message, which is built of its fields as plain values.

    A field that is a message is a mapping of its fields, or a sequence of all of them. What is not given is
    zero or empty.
    """
    return bytes(store().serialize_cdr(_message(name, values), name))


def _message(name: str, values: Any) -> Any:
    fields = store().fielddefs[name][1]
    if not isinstance(values, Mapping):
        values = dict(zip((field for field, _ in fields), values, strict=False))
    return store().types[name](**{field: _field(kind, values.get(field)) for field, kind in fields})


def _field(kind: Any, value: Any) -> Any:
    mark, content = kind
    if mark == _BASE:
        return value if value is not None else "" if content[0] == "string" else 0
    if mark == _MESSAGE:
        return _message(content, () if value is None else value)
    (mark, of), count = content
    if mark == _BASE and of[0] != "string":
        return np.zeros(count, of[0]) if value is None else np.asarray(value, of[0])
    return [_field((mark, of), item) for item in value or ()]
