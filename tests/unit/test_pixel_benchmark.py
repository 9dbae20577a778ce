"""The benchmark of pixel spaces on a folder of small recordings."""

import json

import numpy as np
import pytest

from comotion_deploy.cli import run
from comotion_experiments.pixels import find_data_sets
from comotion_experiments.pixels.methods import spectral_distance, spectral_interaction
from comotion_experiments.pixels.sequences import Sequence


def sequence(name="scene_g12"):
    """Two bodies of 20 and 15 features that move apart; the last five are seen late, one never scored."""
    rng = np.random.default_rng(0)
    t = np.arange(16)[:, None, None]
    x = rng.uniform(0, 100, (1, 35, 2)) + np.where(np.arange(35) < 20, 0, 250)[None, :, None]
    rate = np.where(np.arange(35) < 20, 1.5, -2.0)[None, :, None] * np.array([1.0, 0.4])
    positions = x + rate * t + rng.normal(0, 0.1, (16, 35, 2))
    positions[:8, 30:] = np.nan
    truth = np.where(np.arange(35) < 20, 1, 2)
    truth[0] = -1
    return Sequence(name, positions, np.arange(16) / 15, truth)


@pytest.fixture
def folder(tmp_path):
    one = sequence()
    (tmp_path / "data" / "mtpv").mkdir(parents=True)
    np.savez(
        tmp_path / "data" / "mtpv" / "scene.npz", positions=one.positions, times=one.times, labels=one.truth
    )
    return tmp_path / "data"


def test_parts_of_a_sequence():
    one = sequence()
    assert one.scene == "scene"
    assert one.objects() == 2
    assert one.first(8).positions.shape == (8, 30, 2)


def test_baselines_that_are_told_the_number_find_two_distant_bodies():
    one = sequence().of(np.arange(35) < 30)
    for method in (spectral_distance, spectral_interaction):
        assert len(np.unique(method(one))) == 2


def test_the_command_writes_a_table(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(["dev", "reproduce", "pixels", "--data", str(folder), "--out", str(out), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    rows = {(row["method"], row["frames"]): row for row in shown["rows"]}
    whole = rows["comotion, K unknown", None]
    assert (whole["error"], whole["k_exact"], whole["nmi"]) == (0.0, 100.0, 1.0)
    # One of the two bodies has 19 scored features of 34, so the rest is wrong.
    assert rows["one object", None]["error"] == pytest.approx(100 * 15 / 34)
    assert json.loads((out / "pixels.json").read_text()) == shown
    assert "| MTPV (1) | comotion, K unknown | 0.0 |" in (out / "pixels.md").read_text()


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(ValueError, match="holds none"):
        find_data_sets(tmp_path)
