"""Proprioception: the links of a robot as 6-DoF features, from its joint positions."""

from .kinematics import Encoders, Kinematics, LinkPoses
from .model import load_model
from .samples import JointSample, joint_sample

__all__ = [
    "Encoders",
    "JointSample",
    "Kinematics",
    "LinkPoses",
    "joint_sample",
    "load_model",
]
