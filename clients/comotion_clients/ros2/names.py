"""Keys and liveliness tokens of rmw_zenoh, as Jazzy and Rolling use them. Pure."""

import re
import struct
from dataclasses import dataclass

from comotion_schemas.errors import KnownError

# Quality of service in a token: all defaults, depth 10.
_QOS = "::,10:,:,:,,"
_GID_BYTES = 16


def topic_chunk(scene: str) -> str:
    """Name of a scene as a chunk of a ROS topic: letters, digits and ``_``, not a digit first."""
    chunk = re.sub("[^A-Za-z0-9_]", "_", scene)
    return f"s{chunk}" if chunk[:1].isdigit() else chunk


def dds_name(kind: str) -> str:
    """DDS name of a type: ``sensor_msgs/msg/PointCloud2`` is ``sensor_msgs::msg::dds_::PointCloud2_``."""
    package, middle, name = kind.split("/")
    return f"{package}::{middle}::dds_::{name}_"


def topic_key(domain: int, topic: str, kind: str, hash_: str) -> str:
    """Key on which a topic is published."""
    return f"{domain}/{topic.strip('/')}/{dds_name(kind)}/{hash_}"


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
    """The 33 bytes that go with every message: number, time of sending, and the publisher's id [16].

    Raises
    ------
    ValueError
        If the id does not have 16 bytes.
    """
    if len(gid) != _GID_BYTES:
        raise KnownError(f"the id of a publisher has {len(gid)} bytes, not {_GID_BYTES}")
    return struct.pack("<qqB", sequence, stamp_ns, _GID_BYTES) + gid
