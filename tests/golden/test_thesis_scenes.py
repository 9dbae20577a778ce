"""The simulated scenes of the thesis give its figures, averaged over the seeds 0 to 4."""

from functools import cache

import numpy as np
import pytest

from comotion import FusionConfig
from comotion_experiments.offline import Run, run_offline
from comotion_sources.simulator import batches, load_scene, simulate

SEEDS = range(5)
FRAME = 1 / 15


@cache
def runs(scene: str, sigma_switch: float, v_move: float | None, period: float) -> list[Run]:
    spec = load_scene(scene)
    config = FusionConfig(method="thesis", thesis={"sigma_switch": sigma_switch, "v_move": v_move})
    return [run_offline(batches(simulate(spec, seed=seed)), config, period=period) for seed in SEEDS]


def curve(scene, sigma_switch, v_move=None, period=1 / 3):
    """(seconds [updates], NMI [seeds, updates])."""
    by_seed = runs(scene, sigma_switch, v_move, period)
    return by_seed[0].seconds, np.array([run.nmi for run in by_seed])


def test_figure_4_1_with_the_best_sigma_is_perfect_from_1_5_s_on():
    t, nmi = curve("fig4_1", 0.02)
    np.testing.assert_array_equal(nmi[:, t >= 1.5], 1.0)
    assert len(t) == 30


def test_figure_4_1_with_sigma_too_small_leaves_every_trajectory_alone():
    t, nmi = curve("fig4_1", 0.005)
    assert nmi.mean() == pytest.approx(0.23, abs=0.01)
    assert np.abs(nmi[:, t >= 1] - 0.23).max() < 0.01
    hypotheses = [s.hypotheses for run in runs("fig4_1", 0.005, None, 1 / 3) for s in run.scores]
    assert np.median(hypotheses) >= 48


def test_figure_4_1_with_sigma_too_large_takes_5_s_to_see_the_object():
    t, nmi = curve("fig4_1", 0.08)
    np.testing.assert_array_equal(nmi[:, np.isclose(t, 3.0)], 0.0)
    np.testing.assert_array_equal(nmi[:, t >= 5.0 - 1e-6], 1.0)


@pytest.mark.parametrize("respawn", [2, 4, 6])
def test_figure_4_4_drops_when_features_are_replaced_and_recovers(respawn):
    t, nmi = curve("fig4_4", 0.01, period=FRAME)
    mean = nmi.mean(axis=0)
    before, drop = np.isclose(t, respawn - FRAME), (t > respawn - 1e-6) & (t < respawn + 0.2)
    assert mean[before] > 0.88
    assert mean[drop].mean() == pytest.approx(0.65, abs=0.06)
    assert mean[np.isclose(t, respawn + 1.4)] > 0.88


def test_figure_4_3_weights_see_a_late_start_a_little_sooner():
    first = {}
    for v_move in (0.1, None):
        t, nmi = curve("fig4_3", 0.01, v_move, period=0.2)
        assert np.all(nmi[:, t < 10] == 0)
        perfect = nmi.min(axis=0) == 1
        first[v_move] = t[perfect].min()
        assert perfect[t >= first[v_move]].all()
    assert 10 < first[0.1] < first[None] < 11
