"""Messages of ROS 2: their types and decoding by rosbags (extra ``ros``), their keys in rmw_zenoh."""

import re
from functools import cache
from typing import Any

from .errors import InputError

# vision_msgs 4. The hash of a type depends on names and types of its fields alone.
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
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
}
# motion_capture_tracking.
_MOCAP = {
    "motion_capture_tracking_interfaces/msg/NamedPose": "string name\ngeometry_msgs/Pose pose\n",
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": (
        "std_msgs/Header header\nmotion_capture_tracking_interfaces/NamedPose[] poses\n"
    ),
}


@cache
def store() -> Any:
    """Return the types of ROS 2 Jazzy, vision_msgs and motion_capture_tracking.

    Raises
    ------
    ImportError
        If rosbags is not installed.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 - an extra

    types = get_typestore(Stores.ROS2_JAZZY)
    for name, text in (_VISION | _MOCAP).items():
        types.register(get_types_from_msg(text, name))
    return types


def from_cdr(raw: bytes, kind: str) -> Any:
    """Decode a message in CDR with its 4 bytes of encapsulation header.

    Raises
    ------
    InputError
        If the bytes are not a message of this type.
    ImportError
        If rosbags is not installed.
    """
    types = store()
    if len(raw) < 4 or raw[0] != 0 or raw[1] not in (0, 1):
        raise InputError("not a CDR payload")
    try:
        return types.deserialize_cdr(raw, kind)
    except Exception as error:  # rosbags raises many types on malformed bytes
        raise InputError(f"not a {kind}: {type(error).__name__}") from None


def stamp_of(header: Any, received_ns: int) -> int:
    """Acquisition time of a message, ns; that of its receipt if its header has none."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec) or received_ns


def topic_key(topic: str, domain: int = 0, kind: str = "*", digest: str = "*") -> str:
    """Return the key expression on which rmw_zenoh publishes a topic.

    The layout of rmw_zenoh is ``<domain>/<topic without outer slashes>/<DDS type>/<type hash>``. The
    hash differs between ROS distributions; the key expression matches all of them.

    DDS type `kind` and type hash `digest` are any by default; `domain` is the domain id.

    Raises
    ------
    InputError
        If the topic is not a valid ROS name.
    """
    name = topic.strip("/")
    if not all(re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", chunk) for chunk in name.split("/")):
        raise InputError(f"{topic!r} is not a ROS topic")
    return f"{domain}/{name}/{kind}/{digest}"
