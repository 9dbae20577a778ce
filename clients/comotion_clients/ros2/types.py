"""What travels in a ROS 2 network: messages of plain values as CDR, and keys and tokens of rmw_zenoh. Pure.

Types of messages and their hashes are those of rosbags (extra ``ros``); keys as Jazzy and Rolling use them.
"""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
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
    (mark, item_type), count = content
    if mark == _BASE and item_type[0] != "string":
        return np.zeros(count, item_type[0]) if value is None else np.asarray(value, item_type[0])
    return [_field((mark, item_type), item) for item in value or ()]


# Quality of service in a token: all defaults, depth 10.
_QOS = "::,10:,:,:,,"


def topic_chunk(scene: str) -> str:
    """Name of a scene as a chunk of a ROS topic: letters, digits and ``_``, not a digit first."""
    chunk = re.sub("[^A-Za-z0-9_]", "_", scene)
    return f"s{chunk}" if chunk[:1].isdigit() else chunk


def dds_name(kind: str) -> str:
    """DDS name of a type: ``sensor_msgs/msg/PointCloud2`` is ``sensor_msgs::msg::dds_::PointCloud2_``."""
    package, middle, name = kind.split("/")
    return f"{package}::{middle}::dds_::{name}_"


@dataclass(frozen=True)
class Node:
    """A node of a ROS network: its domain, the Zenoh id of its session and its name."""

    domain: int
    zid: str
    name: str

    def token(self) -> str:
        """Liveliness token of the node."""
        return f"@ros2_lv/{self.domain}/{self.zid}/0/0/NN/%/%/{self.name}"

    def publisher_token(self, number: int, topic: str, kind: str, hash_: str) -> str:
        """Liveliness token of its publisher `number` (from 1)."""
        mangled = "%" + topic.strip("/").replace("/", "%")
        return (
            f"@ros2_lv/{self.domain}/{self.zid}/0/{number}/MP/%/%/{self.name}/"
            f"{mangled}/{dds_name(kind)}/{hash_}/{_QOS}"
        )


def attachment(sequence: int, stamp_ns: int, gid: bytes) -> bytes:
    """The 33 bytes that go with every message: number, time of sending, and the publisher's id [16]."""
    return struct.pack("<qqB16s", sequence, stamp_ns, len(gid), gid)
