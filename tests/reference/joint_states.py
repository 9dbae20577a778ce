"""Joint states as ROS 2 publishes them."""

from collections.abc import Sequence

import numpy as np

from comotion_schemas.ros_types import store
from comotion_sources.proprioception.cdr import JOINT_STATE
from comotion_sources.proprioception.samples import JointSample


def encode_sample(sample: JointSample, velocities: Sequence[float] = ()) -> bytes:
    """Encode a sample as a little-endian CDR JointState, as ROS 2 publishes it."""
    types = store().types
    sec, nanosec = divmod(sample.stamp_ns, 1_000_000_000)
    time = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    message = types[JOINT_STATE](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id=""),
        name=list(sample.names),
        position=np.asarray(sample.positions, np.float64),
        velocity=np.asarray(velocities, np.float64),
        effort=np.empty(0),
    )
    return bytes(store().serialize_cdr(message, JOINT_STATE))
