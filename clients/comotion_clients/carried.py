"""Hypotheses in the axes of their space, also where its frame moves, as that of a carried camera. Pure.

In such a space everything is in the axes of the frame at the stamp but `pose`, which is relative to the
world. What is drawn beside the features needs the pose in the same axes as they are.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from comotion_schemas import HypothesisUpdate, Pose


def poses_in_space(update: HypothesisUpdate) -> HypothesisUpdate:
    """The same update, with every pose in the axes of its space at the stamp.

    Where the frame of a space is known in the world, x(world) = F x(frame), the pose P of a hypothesis
    becomes F^-1 P: it takes the body from where it was born, in the axes of the world, to where it is in
    those of the frame.
    """
    if not update.frames:
        return update
    back = {space: transform(frame).inv() for space, frame in update.frames.items()}
    turned = [
        one
        if one.pose is None or one.space not in back
        else replace(one, pose=_moved(back[one.space], one.pose))
        for one in update.hypotheses
    ]
    return replace(update, hypotheses=turned)


def transform(pose: Pose) -> RigidTransform:
    """A pose in space; one in the plane becomes that in z = 0."""
    turn = pose.rotation
    rotation = Rotation.from_quat(turn) if isinstance(turn, list) else Rotation.from_rotvec([0.0, 0.0, turn])
    return RigidTransform.from_components(np.array([*pose.translation, 0.0][:3]), rotation)


def _moved(frame: RigidTransform, pose: Pose) -> Pose:
    shift, turn = (frame * transform(pose)).as_components()
    dim = len(pose.translation)
    rotation = turn.as_quat().tolist() if dim == 3 else float(turn.as_rotvec()[2])
    return Pose(translation=shift[:dim].tolist(), rotation=rotation)
