"""ROS 2 message types, their hashes and CDR, by rosbags (extra ``ros``)."""

from functools import cache
from typing import Any

from comotion_schemas.ros_types import store

TF = "tf2_msgs/msg/TFMessage"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
ODOMETRY = "nav_msgs/msg/Odometry"
CLOUD = "sensor_msgs/msg/PointCloud2"
MARKERS = "visualization_msgs/msg/MarkerArray"
JOINTS = "sensor_msgs/msg/JointState"


@cache
def make(name: str) -> Any:
    """Return the class of a message type, given with or without ``/msg/``."""
    package, _, kind = name.partition("/")
    return store().types[name if kind.startswith("msg/") else f"{package}/msg/{kind}"]


@cache
def type_hash(name: str) -> str:
    """Hash of a message type, ``RIHS01_...``."""
    return str(store().hash_rihs01(name))


@cache
def definition(name: str) -> str:
    """Text of a message type with all types that it contains."""
    return str(store().generate_msgdef(name, ros_version=2)[0])


def to_cdr(message: Any, name: str) -> bytes:
    """Encode a message."""
    return bytes(store().serialize_cdr(message, name))
