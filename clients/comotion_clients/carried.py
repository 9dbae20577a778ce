"""Hypotheses in the axes of their space, also where its frame moves, as that of a carried camera. Pure.

In such a space everything is in the axes of the frame at the stamp but `pose`, which is relative to the
world. What is drawn beside the features needs the pose in the same axes as they are.
"""

from dataclasses import replace

from comotion_schemas import HypothesisUpdate
from comotion_schemas.rigid import pose_of, transform


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
        body
        if body.pose is None or body.space not in back
        else replace(
            body,
            pose=pose_of(back[body.space] * transform(body.pose), len(body.centroid)),
        )
        for body in update.hypotheses
    ]
    return replace(update, hypotheses=turned)
