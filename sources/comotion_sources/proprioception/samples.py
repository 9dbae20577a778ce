"""One reading of a robot's joints, whatever it came from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class JointSample:
    """Joint positions at one instant.

    Attributes
    ----------
    stamp_ns
        Acquisition time, nanoseconds since the Unix epoch (of a log: its own clock).
    names
        Names of the joints.
    positions
        float64 [J], rad or m.
    """

    stamp_ns: int
    names: Sequence[str]
    positions: Vector


class SampleError(ValueError):
    """An input that is no reading of joints; the message is one line."""


def joint_sample(stamp_ns: int, names: Sequence[str], positions: object) -> JointSample:
    """Build a sample from parts that come from outside.

    Raises
    ------
    SampleError
        If names and positions do not match, a name occurs twice, or a position is not finite.
    """
    values = np.asarray(positions, np.float64)
    if values.shape != (len(names),):
        raise SampleError(f"{len(names)} joint names but {values.size} positions")
    if len(set(names)) != len(names):
        raise SampleError("a joint is named twice")
    if not np.isfinite(values).all():
        raise SampleError("a joint position is not finite")
    if not 0 <= stamp_ns < 2**63:
        raise SampleError(f"stamp {stamp_ns} is out of range")
    return JointSample(stamp_ns, tuple(names), values)
