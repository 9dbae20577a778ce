"""The workcell: motion, truth, images that a tracker can work with, and files others can read."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_experiments.segment import SegmentOptions, segment
from comotion_sources.cameras.tum import TumFolder

mujoco = pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion_sources.klt.config import TrackerConfig  # noqa: E402
from comotion_sources.poses import read_trajectory  # noqa: E402
from comotion_sources.workcell import Scene  # noqa: E402
from comotion_sources.workcell.camera import WorkcellCamera, parse, write_tum  # noqa: E402
from comotion_sources.workcell.render import MOVING, Renderer  # noqa: E402
from comotion_sources.workcell.viewpoint import calibration  # noqa: E402


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
