"""Messages of ROS 2 as bytes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from comotion_schemas.ros_types import store
from comotion_sources.proprioception.samples import JOINT_STATE, JointSample


def make(kind: str, /, **fields: Any) -> Any:
    """A message, or a part of one, by the name of its type."""
    return store().types[kind](**fields)


def header(frame: str = "world", stamp_ns: int = 5 * 10**9 + 7) -> Any:
    """Header with a frame and a stamp."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def raw(message: Any, kind: str) -> bytes:
    """Little-endian CDR, as ROS 2 publishes it."""
    return bytes(store().serialize_cdr(message, kind))


def encode_sample(sample: JointSample, velocities: Sequence[float] = ()) -> bytes:
    """A sample as JointState."""
    message = make(
        JOINT_STATE,
        header=header("", sample.stamp_ns),
        name=list(sample.names),
        position=np.asarray(sample.positions, np.float64),
        velocity=np.asarray(velocities, np.float64),
        effort=np.empty(0),
    )
    return raw(message, JOINT_STATE)
