"""ROS 2 ``sensor_msgs/msg/JointState`` in CDR -> joint samples, by rosbags (extra ``ros``)."""

from typing import Any

from comotion_schemas.ros_types import from_cdr

from ..errors import InputError
from .samples import JointSample, joint_sample

JOINT_STATE = "sensor_msgs/msg/JointState"


def decode_message(raw: bytes) -> Any:
    """Decode a CDR payload with its 4 bytes of encapsulation header.

    Raises
    ------
    InputError
        If the payload is not a JointState.
    """
    return from_cdr(raw, JOINT_STATE)


def from_message(message: Any, received_ns: int) -> JointSample:
    """Convert a JointState message; one without a stamp gets the time of its receipt.

    Raises
    ------
    InputError
        If names and positions do not match or a number is not finite.
    """
    stamp = message.header.stamp
    stamp_ns = int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
    return joint_sample(stamp_ns or received_ns, message.name, message.position)


def ros_key(topic: str, domain: int = 0) -> str:
    """Return the key expression on which rmw_zenoh publishes a topic of joint states.

    The layout of rmw_zenoh is ``<domain>/<topic without outer slashes>/<DDS type>/<type hash>``. The
    hash differs between ROS distributions; the key expression matches all of them.

    Raises
    ------
    InputError
        If the topic is not a valid ROS name.
    """
    name = topic.strip("/")
    chunks = name.split("/")
    if not all(chunk and (chunk[0].isalpha() or chunk[0] == "_") for chunk in chunks) or not all(
        character.isascii() and (character.isalnum() or character in "_/") for character in name
    ):
        raise InputError(f"{topic!r} is not a ROS topic")
    return f"{domain}/{name}/sensor_msgs::msg::dds_::JointState_/*"
