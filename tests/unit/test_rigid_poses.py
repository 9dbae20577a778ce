"""Poses of messages as transforms of SciPy and back, in 2-D and 3-D."""

import numpy as np
import pytest

from comotion_schemas import Pose
from comotion_schemas.rigid import matrix, pose_of, transform

POSES = [
    Pose(translation=[1.0, -2.0], rotation=0.7),
    Pose(translation=[1.0, -2.0, 3.0], rotation=[0.5, 0.5, 0.5, 0.5]),
]


@pytest.mark.parametrize("pose", POSES, ids=["2-D", "3-D"])
def test_a_pose_comes_back_and_moves_points_as_it_says(pose):
    dim = len(pose.translation)
    found = pose_of(transform(pose), dim)
    assert found.translation == pytest.approx(pose.translation)
    assert found.rotation == pytest.approx(pose.rotation)
    point = np.array([0.3, -0.4, 0.5])[:dim]
    moved = transform(pose).apply([*point, 0.0][:3])
    assert moved[:dim] == pytest.approx(matrix(pose.rotation) @ point + pose.translation)


def test_an_angle_turns_from_x_to_y():
    assert matrix(np.pi / 2) @ [1.0, 0.0] == pytest.approx([0.0, 1.0])
