"""Converts poses, rotations and velocities of messages, in 2-D and 3-D alike, to those of SciPy and back.

What lies in a plane is taken for what lies in z = 0: an angle in rad turns about z.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from .hypotheses import Pose, Twist

Floats = NDArray[np.float64]


def three(values: Sequence[float]) -> Floats:
    """Two or three coordinates as float64 [3]."""
    return np.array([*values, 0.0][:3], np.float64)


def rotation(turn: list[float] | float) -> Rotation:
    """Rotation of a quaternion (x, y, z, w), or of an angle."""
    return Rotation.from_quat(turn) if isinstance(turn, list) else Rotation.from_rotvec([0.0, 0.0, turn])


def turn_of(rotation: Rotation, dim: int) -> list[float] | float:
    """The quaternion of a rotation, or in 2-D its angle."""
    return rotation.as_quat().tolist() if dim == 3 else float(rotation.as_rotvec()[2])


def matrix(turn: list[float] | float) -> Floats:
    """Rotation matrix float64 [3, 3] of a quaternion, or [2, 2] of an angle."""
    dim = 3 if isinstance(turn, list) else 2
    return np.asarray(rotation(turn).as_matrix()[:dim, :dim], np.float64)


def transform(pose: Pose) -> RigidTransform:
    """A pose as a transform."""
    return RigidTransform.from_components(three(pose.translation), rotation(pose.rotation))


def pose_of(transform: RigidTransform, dim: int) -> Pose:
    """The pose of a transform."""
    shift, turn = transform.as_components()
    return Pose(translation=shift[:dim].tolist(), rotation=turn_of(turn, dim))


def spin(twist: Twist) -> Floats:
    """Angular velocity float64 [3], rad/s."""
    return np.array(twist.angular if isinstance(twist.angular, list) else [0.0, 0.0, twist.angular])
