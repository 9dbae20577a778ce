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

    Raises
    ------
    InputError
        If names and positions do not match, a name occurs twice, or a position is not finite.
    """

    stamp_ns: int
    names: Sequence[str]
    positions: Vector

    def __post_init__(self) -> None:
        values = np.asarray(self.positions, np.float64)
        object.__setattr__(self, "positions", values)
        if values.shape != (len(self.names),):
            raise InputError(f"{len(self.names)} joint names but {values.size} positions")
        if len(set(self.names)) != len(self.names):
            raise InputError("a joint is named twice")
        if not np.isfinite(values).all():
            raise InputError("a joint position is not finite")
        if not 0 <= self.stamp_ns < 2**63:
            raise InputError(f"stamp {self.stamp_ns} is out of range")


def ros_sample(raw: bytes, received_ns: int) -> JointSample:
    """Read a ROS 2 JointState in CDR; one without a stamp gets the time of its receipt.

    Raises
    ------
    InputError
        If it is none, names and positions do not match, or a number is not finite.
    """
    message = from_cdr(raw, JOINT_STATE)
    return JointSample(stamp_of(message.header, received_ns), message.name, message.position)
