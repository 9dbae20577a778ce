"""A camera whose pose is known: pose buffer, trajectory files, the carrier, and the workcell's hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_sources.calibration.model import Extrinsics, Intrinsics
from comotion_sources.cameras.types import Frame
from comotion_sources.frames import MessageBuilder
from comotion_sources.klt.carrier import Carrier, CarrierName
from comotion_sources.klt.observer import CameraSpace, Observer
from comotion_sources.klt.tracker import Tracks
from comotion_sources.poses import PoseBuffer, read_trajectory

from ..builders import MS, batch


def pose(angle, x):
    return Extrinsics(Rotation.from_rotvec([0, 0, angle]).as_matrix(), np.array([x, 0.0, 0.0]))


def test_poses_are_interpolated_between_their_stamps_and_not_beyond():
    buffer = PoseBuffer()
    assert buffer.at(0) is None
    buffer.add(0, pose(0.0, 0.0))
    buffer.add(100 * MS, pose(1.0, 2.0))
    found = buffer.at(25 * MS)
    assert found.translation == pytest.approx([0.5, 0, 0])
    assert Rotation.from_matrix(found.rotation).as_rotvec() == pytest.approx([0, 0, 0.25])
    assert buffer.at(100 * MS).translation == pytest.approx([2.0, 0, 0])
    assert buffer.at(101 * MS) is None
    assert buffer.at(-1) is None


def test_a_trajectory_file_is_read_to_the_nanosecond(tmp_path):
    file = tmp_path / "groundtruth.txt"
    file.write_text(
        "# stamp tx ty tz qx qy qz qw\n\n1305031102.175304 1 2 3 0 0 0 1\n1305031102.2 2 2 3 0 0 0 1\n"
    )
    buffer = read_trajectory(file)
    assert buffer.newest_ns == 1305031102_200_000_000
    assert buffer.at(1305031102_175_304_000).translation == pytest.approx([1, 2, 3])


def test_the_carrier_takes_its_own_poses_only():
    buffer = PoseBuffer()
    carrier = Carrier.__new__(Carrier)
    carrier._name, carrier._poses = CarrierName.parse("robot:3"), buffer
    positions, turns = [[9, 9, 9], [1, 0, 0], [2, 0, 0]], [[0, 0, 0, 1]] * 3
    stamps = {"stamp_ns": 20, "stamps_ns": [20, 10, 20]}
    carrier.add(batch("robot", positions=positions, ids=[2, 3, 3], quaternions=turns, **stamps))
    assert buffer.at(10).translation == pytest.approx([1, 0, 0])
    assert buffer.newest_ns == 20
    with pytest.raises(ValueError, match="SOURCE:ID"):
        CarrierName.parse("robot:left")


def test_features_are_published_in_the_world_by_the_pose_at_their_stamp():
    buffer = PoseBuffer()
    buffer.add(0, pose(0.0, 0.0))
    buffer.add(100 * MS, pose(0.0, 1.0))
    space = CameraSpace("world", "m", 3, Intrinsics(10, 10, 5.0, 5.0, 5.0, 5.0))
    builder = MessageBuilder(source="klt", session="0" * 16, space="world", unit="m", dim=3)
    observer = Observer(space, builder, poses=buffer)

    def seen(stamp):
        tracks = Tracks(
            stamp_ns=stamp,
            ids=np.array([4], np.uint64),
            pixels=np.zeros((1, 2), np.float32),
            pixel_sigma=np.ones(1),
            points=np.array([[0.0, 0.0, 2.0]]),
            sigma=np.array([0.01]),
            born=np.zeros(1, bool),
            ended=np.zeros(0, np.uint64),
        )
        (batch,) = observer.messages(tracks, Frame(stamp, np.zeros((10, 10), np.uint8)))
        return batch

    assert seen(50 * MS).positions[0] == pytest.approx([0.5, 0, 2])
    assert len(seen(150 * MS).ids) == 0
    assert observer.unposed == 1
