"""Joint samples: the joint positions of a robot at one instant."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.ros_types import from_cdr, stamp_of

from ..errors import InputError

Vector = NDArray[np.float64]
JOINT_STATE = "sensor_msgs/msg/JointState"


@dataclass(frozen=True, slots=True, eq=False)
class JointSample:
    """Joint positions at one instant.

    Attributes
    ----------
    stamp_ns
        Acquisition time, nanoseconds since the Unix epoch (in a log: the clock of the log).
    names
        Names of the joints.
    positions
        float64 [J], rad (hinge) or m (slide).
    """

    stamp_ns: int
    names: Sequence[str]
    positions: Vector


def joint_sample(stamp_ns: int, names: Sequence[str], positions: object) -> JointSample:
    """Build and validate a sample.

    Raises
    ------
    InputError
        If names and positions do not match, a name occurs twice, or a position is not finite.
    """
    values = np.asarray(positions, np.float64)
    if values.shape != (len(names),):
        raise InputError(f"{len(names)} joint names but {values.size} positions")
    if len(set(names)) != len(names):
        raise InputError("a joint is named twice")
    if not np.isfinite(values).all():
        raise InputError("a joint position is not finite")
    if not 0 <= stamp_ns < 2**63:
        raise InputError(f"stamp {stamp_ns} is out of range")
    return JointSample(stamp_ns, tuple(names), values)


def ros_sample(raw: bytes, received_ns: int) -> JointSample:
    """Read a ROS 2 JointState in CDR; one without a stamp gets the time of its receipt.

    Raises
    ------
    InputError
        If it is none, names and positions do not match, or a number is not finite.
    """
    message = from_cdr(raw, JOINT_STATE)
    return joint_sample(stamp_of(message.header, received_ns), message.name, message.position)
