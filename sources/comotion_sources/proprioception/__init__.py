"""Proprioception: what a robot knows of its own links, as 6-DoF features."""

from .kinematics import Encoders, Kinematics, LinkPoses
from .model import load_model
from .samples import JointSample, SampleError, joint_sample

__all__ = [
    "Encoders",
    "JointSample",
    "Kinematics",
    "LinkPoses",
    "SampleError",
    "joint_sample",
    "load_model",
]
