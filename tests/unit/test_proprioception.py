"""Proprioception: kinematics against MuJoCo and by hand, readings from every input, batches."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion_sources.calibration.model import Extrinsics
from comotion_sources.proprioception.joints import JointSample, read_csv

mujoco = pytest.importorskip("mujoco", reason="needs the extra sim3d (mujoco)")

from comotion_sources.proprioception.kinematics import Encoders, Kinematics, load_model  # noqa: E402
from comotion_sources.proprioception.process import Packer  # noqa: E402
from comotion_sources.workcell import Scene  # noqa: E402

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


def packer(rate=200.0, span=0.02):
    scene = Scene("arm")
    made = Packer(Kinematics(scene.model, scene.robot), rate=rate, span=span)
    return made, lambda t: reading(scene.joints, scene.configuration(t), round(t * 1e9))


@pytest.mark.parametrize(("given", "rate"), [(500, 200), (200, 200), (190, 200), (1000, 100), (100, 500)])
def test_the_rate_is_a_limit_that_jitter_does_not_halve(given, rate):
    made, at = packer(rate=rate, span=0.1)
    rng = np.random.default_rng(7)
    packs = [made.add(at(k / given + rng.uniform(0, 0.1) / given)) for k in range(2 * given)]
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
