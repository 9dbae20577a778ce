"""ROS 2 message types, their hashes and CDR, by rosbags (extra ``ros``)."""

from functools import cache
from typing import Any

TF = "tf2_msgs/msg/TFMessage"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
ODOMETRY = "nav_msgs/msg/Odometry"
CLOUD = "sensor_msgs/msg/PointCloud2"
MARKERS = "visualization_msgs/msg/MarkerArray"
JOINTS = "sensor_msgs/msg/JointState"

# vision_msgs 4, which rosbags does not have. The hash depends on names and types of the fields alone.
_VISION = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id\n"
    ),
    DETECTIONS: "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}


@cache
def store() -> Any:
    """Return the types of ROS 2 Jazzy, with vision_msgs.

    Raises
    ------
    ImportError
        If rosbags is not installed.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = get_typestore(Stores.ROS2_JAZZY)
    for name, text in _VISION.items():
        found.register(get_types_from_msg(text, name))
    return found


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
