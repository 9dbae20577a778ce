"""Camera models, calibration files, targets, the pose between two cameras, and cameras that are carried."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_schemas import Pose
from comotion_schemas.errors import InputError
from comotion_schemas.rigid import matrix, pose_of, transform
from comotion_sources.calibration.files import format_calibration, read_calibration
from comotion_sources.calibration.model import Extrinsics, Intrinsics
from comotion_sources.cameras.types import Frame
from comotion_sources.klt.observer import CameraSpace, Observer
from comotion_sources.klt.tracker import Tracks
from comotion_sources.markers import find_dictionary
from comotion_sources.pair_calibration import PairedView, calibrate_pair, parse_target, relative_pose
from comotion_sources.poses import PoseBuffer, add_poses, parse_carrier
from comotion_sources.streams import MessageBuilder

from ..builders import MS, batch

CAMERA_A = Intrinsics(640, 480, 560.0, 555.0, 322.0, 238.5)
CAMERA_B = Intrinsics(800, 600, 700.0, 700.0, 405.0, 295.0, np.array([-0.12, 0.05, 0.001, -0.002, 0.0]))

ROS = Path(__file__).parents[1] / "fuzz" / "corpus" / "yaml" / "valid-ros"


def pose(rotation, translation):
    return Extrinsics(Rotation.from_rotvec(rotation).as_matrix(), np.array(translation))


@cache
def all_rays(camera, scale):
    y, x = np.mgrid[: camera.height * scale, : camera.width * scale]
    return camera.rays((np.column_stack([x.ravel(), y.ravel()]) + 0.5) / scale - 0.5)


@dataclass
class Sheet:
    """A printed target: its image, and where its pixels are on the plane z = 0, in m."""

    image: np.ndarray
    metres_per_pixel: float
    origin: tuple[float, float]  # the pixel that is the origin of the target
    y_up: bool = False

    def seen(self, camera, to_camera):
        """The view of the sheet, distortion included, at two times the resolution and averaged."""
        scale = 2
        rays = all_rays(camera, scale) @ to_camera.rotation
        centre = -to_camera.rotation.T @ to_camera.translation
        with np.errstate(divide="ignore", invalid="ignore"):
            hit = centre + rays * (-centre[2] / rays[:, 2])[:, None]
        u = hit[:, 0] / self.metres_per_pixel + self.origin[0]
        v = (-1 if self.y_up else 1) * hit[:, 1] / self.metres_per_pixel + self.origin[1]
        shape = (camera.height * scale, camera.width * scale)
        maps = [np.asarray(m, np.float32).reshape(shape) for m in (u, v)]
        big = cv2.remap(self.image, *maps, cv2.INTER_LINEAR, borderValue=150)
        small = cv2.resize(big, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        return cv2.GaussianBlur(small, (3, 3), 0.6)


def chessboard(columns, rows, square):
    pixels = 40
    y, x = np.mgrid[: (rows + 1) * pixels, : (columns + 1) * pixels]
    dark = (x // pixels + y // pixels) % 2 == 0
    image = np.pad(np.where(dark, 20, 235).astype(np.uint8), pixels, constant_values=235)
    return Sheet(image, square / pixels, (2 * pixels - 0.5, 2 * pixels - 0.5))


def marker(number, size, dictionary):
    pixels = 160
    image = cv2.aruco.generateImageMarker(find_dictionary(dictionary), number, pixels)
    middle = pixels / 2 + 60 - 0.5
    return Sheet(np.pad(image, 60, constant_values=255), size / pixels, (middle, middle), y_up=True)


TARGETS = {
    "chessboard:8x5:0.03": (chessboard(8, 5, 0.03), (-0.1, -0.06, 0.0)),
    "marker:0.16:apriltag_36h11": (marker(5, 0.16, "apriltag_36h11"), (0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_seen_by_both_places_the_second_camera(target):
    sheet, middle = TARGETS[target]
    a_in_world = pose((0.3, -0.1, 0.05), (1.0, 2.0, 0.5))
    b_in_a = pose((0.05, 0.45, -0.1), (-0.35, 0.05, 0.1))
    facing = Rotation.from_euler("x", 180 if sheet.y_up else 0, degrees=True).as_rotvec()
    frames = []
    for i, (rx, ry) in enumerate([(0.3, 0.2), (-0.35, 0.1), (0.1, -0.4), (0.25, 0.4)]):
        turn = Rotation.from_euler("xyz", [rx, ry, 0.3 * i]) * Rotation.from_rotvec(facing)
        to_a = Extrinsics(turn.as_matrix(), np.array([0.05 * i - 0.02, 0.03, 0.75]))
        to_a = to_a.after(pose((0, 0, 0), middle))
        views = [sheet.seen(CAMERA_A, to_a), sheet.seen(CAMERA_B, b_in_a.inverse().after(to_a))]
        frames.append(tuple(Frame(i, view) for view in views))

    result = calibrate_pair(iter(frames), parse_target(target), CAMERA_A, CAMERA_B, a_in_world)

    assert result.views == len(frames)
    assert result.error_a < 0.3
    assert result.error_b < 0.3
    expected = a_in_world.after(b_in_a)
    np.testing.assert_allclose(result.pose.translation, expected.translation, atol=4e-3)
    turned = Rotation.from_matrix(result.pose.rotation.T @ expected.rotation).magnitude()
    assert turned < np.deg2rad(0.4)
    assert result.pose.frame == "world"


@pytest.mark.parametrize("seed", range(5))
def test_a_mirrored_pose_of_the_target_misleads_in_no_single_view(seed):
    """A flat target fits two poses; in one view alone each pose in A has one in B that fits it."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([*np.mgrid[-4:5, -2:4].reshape(2, -1), np.zeros(54)]) * 0.025
    b_in_a = pose((0.0, rng.uniform(0.2, 0.6), 0.0), (-0.5, 0.0, 0.1))
    to_a = pose(tuple(rng.normal(0, 0.3, 3)), (0.0, 0.0, 0.9))
    pixels = [
        camera.project(seen.apply(points)) + rng.normal(0, 0.1, (54, 2))
        for camera, seen in ((CAMERA_A, to_a), (CAMERA_B, b_in_a.inverse().after(to_a)))
    ]
    result = relative_pose(CAMERA_A, CAMERA_B, [PairedView(points, *pixels)]).pose
    assert Rotation.from_matrix(result.rotation.T @ b_in_a.rotation).magnitude() < np.deg2rad(3)


def test_a_target_that_is_not_seen_is_told():
    blank = Frame(0, np.full((480, 640), 128, np.uint8)), Frame(0, np.full((600, 800), 128, np.uint8))
    with pytest.raises(InputError, match="never seen by both"):
        calibrate_pair(iter([blank]), parse_target("chessboard:8x5:0.03"), CAMERA_A, CAMERA_B)
    with pytest.raises(InputError, match="images of 640 x 480, calibration for 800 x 600"):
        calibrate_pair(iter([blank[:1] * 2]), parse_target("chessboard:8x5:0.03"), CAMERA_A, CAMERA_B)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_calibrations_are_read_as_ros_and_opencv_write_them(tmp_path):
    camera = read_calibration(write(tmp_path / "camera.yaml", ROS.read_text())).intrinsics
    assert (camera.width, camera.height, camera.fx, camera.cy) == (640, 480, 438.78, 243.73)
    np.testing.assert_allclose(camera.distortion, [-0.36, 0.11, 0.001, 0.0005, 0.0])
    storage = cv2.FileStorage(str(tmp_path / "camera.yml"), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", CAMERA_B.width)
    storage.write("image_height", CAMERA_B.height)
    storage.write("camera_matrix", CAMERA_B.matrix)
    storage.write("distortion_coefficients", CAMERA_B.distortion[None])
    storage.release()
    camera = read_calibration(tmp_path / "camera.yml").intrinsics
    np.testing.assert_allclose(camera.matrix, CAMERA_B.matrix)
    np.testing.assert_allclose(camera.distortion, CAMERA_B.distortion)


def test_our_toml_round_trips(tmp_path):
    where = Extrinsics(pose((0.4, -0.2, 1.0), (0, 0, 0)).rotation, np.array([0.1, 0.2, 1 / 3]), 'cell "3"')
    back = read_calibration(write(tmp_path / "c.toml", format_calibration(CAMERA_B, where)))
    np.testing.assert_array_equal(back.intrinsics.matrix, CAMERA_B.matrix)
    np.testing.assert_array_equal(back.intrinsics.distortion, CAMERA_B.distortion)
    np.testing.assert_allclose(back.extrinsics.rotation, where.rotation, atol=1e-15)
    np.testing.assert_array_equal(back.extrinsics.translation, where.translation)
    assert back.extrinsics.frame == 'cell "3"'


def test_poses_are_interpolated_between_their_stamps_and_not_beyond():
    buffer = PoseBuffer()
    assert buffer.at(0) is None
    buffer.add(0, pose((0, 0, 0), (0, 0, 0)))
    buffer.add(100 * MS, pose((0, 0, 1), (2, 0, 0)))
    result = buffer.at(25 * MS)
    assert result.translation == pytest.approx([0.5, 0, 0])
    assert Rotation.from_matrix(result.rotation).as_rotvec() == pytest.approx([0, 0, 0.25])
    assert buffer.at(100 * MS).translation == pytest.approx([2.0, 0, 0])
    assert buffer.at(101 * MS) is None
    assert buffer.at(-1) is None


def test_the_carrier_takes_its_own_poses_only():
    buffer = PoseBuffer()
    positions, turns = [[9, 9, 9], [1, 0, 0], [2, 0, 0]], [[0, 0, 0, 1]] * 3
    stamps = {"stamp_ns": 20, "stamps_ns": [20, 10, 20]}
    given = batch("robot", positions=positions, ids=[2, 3, 3], quaternions=turns, **stamps)
    add_poses(buffer, given, parse_carrier("robot:3")[1])
    assert buffer.at(10).translation == pytest.approx([1, 0, 0])
    assert buffer.newest_ns == 20
    with pytest.raises(ValueError, match="SOURCE:ID"):
        parse_carrier("robot:left")


def test_features_are_published_in_the_world_by_the_pose_at_their_stamp():
    buffer = PoseBuffer()
    buffer.add(0, pose((0, 0, 0), (0, 0, 0)))
    buffer.add(100 * MS, pose((0, 0, 0), (1, 0, 0)))
    space = CameraSpace("world", "m", 3, Intrinsics(10, 10, 5.0, 5.0, 5.0, 5.0))
    builder = MessageBuilder(source="klt", session="0" * 16, space="world", unit="m", dim=3)
    observer = Observer(space, builder, poses=buffer)

    feature = {"ids": np.array([4], np.uint64), "ended": np.zeros(0, np.uint64), "pixels": np.zeros((1, 2))}
    feature |= {"sigma": np.ones(1), "born": np.zeros(1, bool)}

    def seen(stamp):
        tracks = Tracks(stamp_ns=stamp, positions=np.array([[0.0, 0.0, 2.0]]), **feature)
        (batch,) = observer.messages(tracks, Frame(stamp, np.zeros((10, 10), np.uint8)))
        return batch

    assert seen(50 * MS).positions[0] == pytest.approx([0.5, 0, 2])
    assert len(seen(150 * MS).ids) == 0
    assert observer.unposed == 1


@pytest.mark.parametrize("turn", [0.7, [0.5, 0.5, 0.5, 0.5]], ids=["2-D", "3-D"])
def test_a_pose_comes_back_and_moves_points_as_it_says(turn):
    dim = 2 if turn == 0.7 else 3
    pose = Pose(translation=[1.0, -2.0, 3.0][:dim], rotation=turn)
    result = pose_of(transform(pose), dim)
    assert result.translation == pytest.approx(pose.translation)
    assert result.rotation == pytest.approx(pose.rotation)
    point = np.array([0.3, -0.4, 0.5])[:dim]
    moved = transform(pose).apply([*point, 0.0][:3])
    assert moved[:dim] == pytest.approx(matrix(pose.rotation) @ point + pose.translation)
    # An angle turns from x to y.
    assert matrix(np.pi / 2) @ [1.0, 0.0] == pytest.approx([0.0, 1.0])
