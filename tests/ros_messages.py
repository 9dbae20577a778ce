"""Messages of ROS 2 as bytes."""

import numpy as np

from comotion_schemas.ros_types import store
from comotion_sources.proprioception.joints import JOINT_STATE


def make(kind, /, **fields):
    """A message, or a part of one, by the name of its type."""
    return store().types[kind](**fields)


def header(frame="world", stamp_ns=5 * 10**9 + 7):
    """Header with a frame and a stamp."""
    sec, nanosec = divmod(stamp_ns, 10**9)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def raw(message, kind):
    """Little-endian CDR, as ROS 2 publishes it."""
    return bytes(store().serialize_cdr(message, kind))


def encode_sample(sample, velocities=()):
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
