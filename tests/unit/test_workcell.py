"""Workcell and proprioception: motion, truth and images; kinematics against MuJoCo and by hand, readings."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_experiments.segment import SegmentOptions, segment
from comotion_sources.calibration.model import Extrinsics
from comotion_sources.cameras.tum import TumFolder
from comotion_sources.proprioception.joints import JointSample, read_csv

mujoco = pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion_sources.klt.config import TrackerConfig  # noqa: E402
from comotion_sources.poses import read_trajectory  # noqa: E402
from comotion_sources.proprioception.kinematics import Encoders, Kinematics, load_model  # noqa: E402
from comotion_sources.proprioception.process import Packer  # noqa: E402
from comotion_sources.workcell import Scene  # noqa: E402
from comotion_sources.workcell.camera import WorkcellCamera, parse, write_tum  # noqa: E402
from comotion_sources.workcell.render import MOVING, Renderer  # noqa: E402
from comotion_sources.workcell.viewpoint import calibration  # noqa: E402

URDF = Path(__file__).parents[1] / "fuzz" / "corpus" / "urdf" / "valid"


@pytest.fixture
def urdf(tmp_path):
    return shutil.copy(URDF, tmp_path / "two.urdf")


def reading(names, positions, stamp_ns=0):
    return JointSample(stamp_ns, names, positions)


def test_urdf_kinematics_agree_with_the_product_of_transformations(urdf):
    """By hand, link after link; meshes that are not there and links without mass do not matter."""
    base = Extrinsics.from_quaternion([0.1, 0.2, 0.3, 0.9], [1.0, -2.0, 0.5])
    kinematics = Kinematics(load_model(urdf), ["upper", "tool0"], base)
    assert kinematics.joints == ("shoulder", "lift")

    def frame(turn, way):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.as_matrix(), way
        return matrix

    rng = np.random.default_rng(5)
    for angle, way in rng.uniform(-0.9, 0.9, (20, 2)):
        start = np.eye(4)
        start[:3, :3], start[:3, 3] = base.rotation, base.translation
        upper = start @ frame(Rotation.from_euler("xyz", [0, 0.2, 0]), [0.1, 0, 0.3])
        upper = upper @ frame(Rotation.from_rotvec([0, 0, angle]), [0, 0, 0])
        tool = upper @ frame(Rotation.from_euler("xyz", [0.3, 0, 0]), [0, 0.2, 0])
        tool = tool @ frame(Rotation.identity(), [way, 0, 0])
        tool = tool @ frame(Rotation.from_euler("xyz", [0, 0, 1.2]), [0, 0, 0.15])
        poses = kinematics.poses(reading(("shoulder", "lift"), np.array([angle, way])))
        for row, expected in enumerate((upper, tool)):
            assert poses.positions[row] == pytest.approx(expected[:3, 3], abs=1e-9)
            turned = Rotation.from_quat(poses.quaternions[row]).as_matrix()
            assert turned == pytest.approx(expected[:3, :3], abs=1e-9)


def test_sigma_is_what_encoders_of_that_resolution_make(urdf):
    """Against the spread of poses under rounding errors drawn at random."""
    coarse = Encoders(angular=0.02, linear=0.004, floor=1e-9)
    kinematics = Kinematics(load_model(urdf), ["tool0"], encoders=coarse)
    rng = np.random.default_rng(6)
    q = np.array([0.3, 0.4])
    errors = rng.uniform(-0.5, 0.5, (4000, 2)) * (0.02, 0.004)
    places = np.array([kinematics.poses(reading(("shoulder", "lift"), q + e)).positions[0] for e in errors])
    expected = np.sqrt(places.var(axis=0).sum() / 3)
    assert kinematics.poses(reading(("shoulder", "lift"), q)).sigma[0] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("given", "rate"), [(500, 200), (200, 200), (190, 200), (1000, 100), (100, 500)])
def test_the_rate_is_a_limit_that_jitter_does_not_halve(given, rate):
    scene, rng = Scene("arm"), np.random.default_rng(7)
    made = Packer(Kinematics(scene.model, scene.robot), rate=rate, span=0.1)
    times = [k / given + rng.uniform(0, 0.1) / given for k in range(2 * given)]
    packs = [made.add(reading(scene.joints, scene.configuration(t), round(t * 1e9))) for t in times]
    instants = sum(len(np.unique(p["stamps_ns"])) for p in [*packs, made.flush()] if p is not None)
    assert instants / 2 == pytest.approx(min(given, rate), rel=0.06)


def test_csv_logs_are_read_with_either_kind_of_time(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "stamp_ns, shoulder, lift\n1795227314415000123,0.5,-0.25\n\n1795227314420000123,0.6,1e-3\n"
    )
    first, second = read_csv(path)
    assert first.stamp_ns == 1795227314415000123
    assert list(first.names) == ["shoulder", "lift"]
    assert second.positions.tolist() == [0.6, 0.001]
    path.write_text("time,lift\n12.5,1\n")
    assert next(read_csv(path)).stamp_ns == 12_500_000_000


def test_depth_and_geoms_agree_with_single_rays_of_mujoco():
    """What cannot move is cast once and moving bodies on top: nothing may get lost between the two."""
    truck = Scene("truck")
    intrinsics, extrinsics = calibration(truck, "a", (320, 240))
    renderer = Renderer(truck, intrinsics, extrinsics)
    for t in (5.0, 10.0):
        ideal = renderer.render(truck.configuration(t))
        data = truck.new_data()
        truck.place(data, truck.configuration(t))
        rng = np.random.default_rng(1)
        moving = np.argwhere(truck.model.geom_group[ideal.geoms] == MOVING)
        pixels = np.concatenate(
            [rng.integers(0, (240, 320), (150, 2)), moving[rng.integers(0, len(moving), 150)]]
        )
        for v, u in pixels:
            ray = extrinsics.rotation @ intrinsics.rays([[u, v]])[0]
            geom = np.zeros(1, np.int32)
            distance = mujoco.mj_ray(truck.model, data, extrinsics.translation, ray, None, 1, -1, geom, None)
            assert ideal.geoms[v, u] == geom[0]
            assert ideal.depth[v, u] == pytest.approx(distance, abs=1e-5)


def test_a_folder_of_a_carried_camera_tells_where_the_camera_was(tmp_path):
    camera = WorkcellCamera(parse("eye-in-hand/hand?size=240x180&rate=10&duration=2"))
    folder = tmp_path / "tum"
    write_tum(camera, folder)
    true = read_trajectory(folder / "groundtruth.txt")
    assert TumFolder(folder).extrinsics is None, "the camera moves"
    options = SegmentOptions(tracker=TrackerConfig(max_features=150, moving=True))
    path = segment(str(folder), options).path
    assert path[-1][0] == 1_900_000_000
    begun = true.at(path[0][0])
    assert begun is not None
    for stamp_ns, pose in path:
        moved = true.at(stamp_ns)
        assert moved is not None
        moved = begun.inverse().after(moved)
        assert isinstance(pose.rotation, list)
        turn = Rotation.from_quat(pose.rotation).inv() * Rotation.from_matrix(moved.rotation)
        assert np.linalg.norm(moved.translation - pose.translation) < 0.01
        assert np.degrees(turn.magnitude()) < 1.0
