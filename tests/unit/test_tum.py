"""Paths in the TUM format: by hand, and as evo reads them where it is installed."""

from dataclasses import replace

import numpy as np
import pytest

from comotion_clients.tum import save_paths
from comotion_schemas import Pose

from .test_joint_clients import update


def moved(number):
    # The camera goes along x, and turns a quarter about z.
    half = np.pi / 4
    pose = Pose(translation=[0.5 * number, 0.0, 1.0], rotation=[0.0, 0.0, np.sin(half), np.cos(half)])
    return replace(update([]), stamp_ns=1_000_000_000 + number * 100_000_000, frames={"cam": pose})


def test_each_instant_of_a_moving_camera_is_one_line(tmp_path):
    files = save_paths(tmp_path / "out", [moved(0), moved(0), moved(1)])
    camera = tmp_path / "out" / "camera-cam.tum"
    assert camera in files
    assert np.loadtxt(camera) == pytest.approx(
        np.array([[1.0, 0, 0, 1, 0, 0, 0.5**0.5, 0.5**0.5], [1.1, 0.5, 0, 1, 0, 0, 0.5**0.5, 0.5**0.5]])
    )


@pytest.mark.filterwarnings("ignore")
def test_evo_reads_and_compares_them(tmp_path):
    files = pytest.importorskip("evo.tools.file_interface")
    from evo.core import metrics

    save_paths(tmp_path, [moved(k) for k in range(5)])
    path = files.read_tum_trajectory_file(str(tmp_path / "camera-cam.tum"))
    assert path.path_length == pytest.approx(2.0)
    error = metrics.APE(metrics.PoseRelation.full_transformation)
    error.process_data((path, path))
    assert error.get_statistic(metrics.StatisticsType.max) == pytest.approx(0.0, abs=1e-9)
