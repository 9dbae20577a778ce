"""A frame that moves: the camera's motion, and hypotheses relative to the world."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig

from ..builders import batch

RATE = 15
SECONDS = 6


def camera(t):
    """Pose of the camera in the world: a turn about y by up to 20 degrees, and a path of some decimetres."""
    turn = Rotation.from_rotvec([0.05 * np.sin(t), 0.35 * np.sin(0.5 * t), 0.0])
    return turn, np.array([0.2 * np.sin(0.7 * t), 0.05 * (1 - np.cos(t)), 0.05 * t])


def batches():
    """A room, and a box that slides through it at 0.1 m/s, seen by a carried camera."""
    rng = np.random.default_rng(5)
    room = rng.uniform([-1.5, -1, 2], [1.5, 1, 4], (40, 3))
    box = rng.uniform(-0.15, 0.15, (12, 3)) + np.array([-0.3, 0, 2])
    for k in range(RATE * SECONDS):
        t = k / RATE
        turn, place = camera(t)
        points = np.vstack([room, box + np.array([0.1 * t, 0, 0])])
        seen = turn.inv().apply(points - place) + rng.normal(0, 0.003, points.shape)
        yield batch("hand", k, round(k * 1e9 / RATE), seen, space="hand/optical", moving=True)


@pytest.fixture(scope="module")
def carried():
    fusion, updates = Fusion(FusionConfig()), []
    for seen in batches():
        fusion.ingest(seen)
        if seen.seq % 5 == 4:
            updates.append(fusion.update(seen.stamp_ns))
    return fusion, updates


def parts(update):
    """World and box of an update."""
    return sorted((h for h in update.hypotheses if not h.absent), key=lambda h: -h.size)[:2]


def origin(updates):
    """The pose of the camera at the first update with a world: its frame is the world then."""
    return camera(next(u for u in updates if u.frames).stamp_ns * 1e-9)


def test_the_motion_of_the_camera_is_that_of_the_world_inverted(carried):
    _, updates = carried
    first, begun = origin(updates)
    for update in updates:
        if "hand/optical" not in update.frames:
            continue
        frame = update.frames["hand/optical"]
        turn, place = camera(update.stamp_ns * 1e-9)
        assert np.linalg.norm(frame.translation - first.inv().apply(place - begun)) < 0.01
        assert np.degrees((Rotation.from_quat(frame.rotation) * turn.inv() * first).magnitude()) < 1.0


def test_bodies_are_described_relative_to_the_world(carried):
    _, updates = carried
    world, box = parts(updates[-1])
    assert (world.size, world.state) == (40, "static")
    assert world.twist.linear == [0, 0, 0]
    assert (box.size, box.state) == (12, "moving")
    turn, _ = camera(updates[-1].stamp_ns * 1e-9)
    assert turn.apply(box.twist.linear) == pytest.approx([0.1, 0, 0], abs=0.03)
    age = (updates[-1].stamp_ns - box.born_ns) * 1e-9
    assert np.degrees(Rotation.from_quat(box.pose.rotation).magnitude()) < 3
    first, begun = origin(updates)
    born = np.array([-0.3 + 0.1 * box.born_ns * 1e-9, 0, 2])
    middle = first.inv().apply(born - begun)
    moved = Rotation.from_quat(box.pose.rotation).apply(middle) + box.pose.translation - middle
    assert first.apply(moved) == pytest.approx([0.1 * age, 0, 0], abs=0.03)


def test_joints_do_not_see_the_motion_of_the_camera(carried):
    _, updates = carried
    world, box = parts(updates[-1])
    (joint,) = (j for j in updates[-1].joints if {j.parent, j.child} == {world.id, box.id})
    assert joint.kind == "prismatic"
    turn, _ = camera(updates[-1].stamp_ns * 1e-9)
    assert abs(turn.apply(joint.axis)[0]) > 0.99
    assert joint.upper - joint.lower > 0.2


def test_a_restart_does_not_move_the_frame(carried):
    fusion, updates = carried
    again = Fusion.restore(fusion.config, fusion.snapshot(clean=True))
    frame = again.update(updates[-1].published_ns).frames["hand/optical"]
    assert frame.translation == pytest.approx(updates[-1].frames["hand/optical"].translation, abs=1e-3)
