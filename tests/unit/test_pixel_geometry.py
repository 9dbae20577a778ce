"""Epipolar geometry of groups: parts of one body in perspective, and two bodies."""

import numpy as np
import pytest

from comotion.pixels.geometry import Geometry
from comotion.pixels.key_frames import KeyFrames

FRAMES, NEAR, FAR, OTHER = 24, np.arange(30), np.arange(30, 60), np.arange(60, 90)
FOCAL = 500.0


def scene(noise, hidden=0.0, drive=(0.05, 0.01, 0.03)):
    """Images of a near and a far part of one scene, and of a body that moves, before a driving camera."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-1.5, -1, 3], [1.5, 1, 5], (90, 3))
    points[FAR, 2] += 3
    positions = np.empty((FRAMES, 90, 2))
    for t in range(FRAMES):
        seen = points - t * np.array(drive)
        seen[OTHER] += t * np.array([-0.03, 0.05, 0.0])
        positions[t] = FOCAL * seen[:, :2] / seen[:, 2:]
    positions += rng.normal(0, noise, positions.shape)
    visible = rng.random((FRAMES, 90)) >= hidden
    return KeyFrames(
        np.where(visible[..., None], positions, 0).astype(np.float32),
        visible,
        np.full(90, noise**2, np.float32),
    )


def geometry(frames):
    return Geometry(frames, [NEAR, FAR, OTHER], drift=0.02)


@pytest.mark.parametrize(("noise", "hidden"), [(0.1, 0.0), (0.1, 0.1)])
def test_parts_of_one_body_share_a_geometry_and_bodies_do_not(noise, hidden):
    found = geometry(scene(noise, hidden))
    one, two = found.compare(NEAR, FAR), found.compare(NEAR, OTHER)
    assert one.log_ratio < 0.4
    assert two.log_ratio > one.log_ratio + 0.3
    assert not found.two_bodies(NEAR, FAR)
    assert found.two_bodies(NEAR, OTHER)
    assert found.one_body(NEAR, FAR)
    assert not found.one_body(NEAR, OTHER)


def test_what_rests_and_what_moves_are_told_apart_before_a_camera_at_rest():
    frames = scene(0.05, drive=(0.0, 0.0, 0.0))
    assert geometry(frames).compare(NEAR, OTHER).one_rests
    assert not geometry(frames).compare(NEAR, FAR).one_rests
    # All rests: nothing says that it is one body.
    assert not geometry(frames).one_body(NEAR, FAR)


def test_too_few_points_say_nothing():
    found = geometry(scene(0.1))
    assert found.compare(NEAR, FAR[:8]) is None
    assert not found.two_bodies(NEAR, OTHER[:4])
    assert not found.one_body(NEAR, FAR[:8])
