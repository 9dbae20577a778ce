"""Proprioception: the links of a robot as 6-DoF features, from its joint positions."""

from .joints import JointSample
from .kinematics import Encoders, Kinematics, LinkPoses, load_model

__all__ = [
    "Encoders",
    "JointSample",
    "Kinematics",
    "LinkPoses",
    "load_model",
]
