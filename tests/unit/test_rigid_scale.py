"""The rigid-motion method on many trajectories: bounded work must find what all of it would."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig
from comotion.rigid import method
from comotion.rigid import subset as subsets
from comotion.rigid.subset import choose_subset
from comotion_clients.metrics import nmi
from comotion_experiments.offline import run_offline
from comotion_schemas import UNDETERMINED
from comotion_sources import simulator

from ..builders import batch

RATE = 15
START = 10**12


class Crowd:
    """Features at rest and on bodies that turn and travel, a few replaced at every frame."""

    def __init__(self, count, bodies, late=0.0, seed=0, sigma=(0.001, 0.003)):
        self.rng = np.random.default_rng(seed)
        self.truth = np.where(np.arange(count) % 2 == 0, 0, 1 + np.arange(count) // 2 % max(bodies, 1))
        self.truth *= bodies > 0
        self.late = np.zeros(bodies + 1)
        self.late[bodies] = late
        self.way = self.rng.normal(0, 0.15, (bodies + 1, 3))
        self.spin = self.rng.normal(0, 0.5, (bodies + 1, 3))
        self.home = self.rng.uniform(-1, 1, (bodies + 1, 3))
        self.place = self._places(self.truth)
        self.sigma = self.rng.uniform(*sigma, (count, 1))
        self.ids = np.arange(count)

    def _places(self, truth):
        spread = np.where(truth[:, None] == 0, 2.0, 0.15)
        return self.rng.uniform(-1, 1, (len(truth), 3)) * spread

    def batch(self, frame):
        gone = np.flatnonzero(self.rng.random(len(self.ids)) < 0.002)
        self.place[gone] = self._places(self.truth[gone])
        self.ids[gone] = self.ids.max() + 1 + np.arange(len(gone))
        x = self.place.copy()
        for k in range(1, len(self.home)):
            mine, t = self.truth == k, max(frame / RATE - self.late[k], 0.0)
            x[mine] = Rotation.from_rotvec(self.spin[k] * t).apply(x[mine]) + self.home[k] + self.way[k] * t
        x += self.rng.normal(size=x.shape) * self.sigma
        return batch("crowd", frame, START + frame * 10**9 // RATE, x, ids=self.ids.copy())

    def truth_of(self, update):
        of = dict(zip(self.ids.tolist(), self.truth.tolist(), strict=True))
        return np.array([of.get(int(i), -1) for i in update.track_id])


def updates_of(crowd, seconds, every=5):
    """(frame, update, truth) of a crowd, three times a second."""
    fusion = Fusion(FusionConfig())
    for frame in range(int(seconds * RATE)):
        seen = crowd.batch(frame)
        fusion.ingest(seen)
        if frame % every == every - 1:
            update = fusion.update(seen.stamp_ns)
            yield frame, update, crowd.truth_of(update)


def test_two_thousand_are_grouped_and_a_late_mover_is_found():
    crowd = Crowd(2000, 6, late=2.0)
    for frame, update, truth in updates_of(crowd, 3.4):
        labels, known = update.track_hypothesis, truth >= 0
        if frame / RATE > 1.5:
            moving = known & (truth != 6)
            assert nmi(labels[moving], truth[moving]) > 0.99
        if 1.0 < frame / RATE < 2.0:
            # At rest still, which only its motion could tell.
            assert len(set(labels[known & ((truth == 6) | (truth == 0))].tolist())) == 1
    assert len(update.hypotheses) == 7
    assert nmi(labels[known], truth[known]) > 0.99


def test_a_crowd_at_rest_is_one_hypothesis_however_noise_differs():
    for frame, update, _ in updates_of(Crowd(1200, 0, sigma=(0.0005, 0.01)), 4.0):
        if frame > RATE:
            assert len(update.hypotheses) == 1
            assert (update.track_hypothesis != UNDETERMINED).mean() > 0.99


@pytest.mark.parametrize("scene", ["3d_4", "fig4_4"])
def test_a_subset_finds_what_everybody_would(scene, monkeypatch):
    spec = simulator.load_scene(scene)

    def score():
        stream = simulator.batches(simulator.simulate(spec, seed=0))
        return run_offline(stream, FusionConfig(), period=1 / 3, duration=4).nmi

    everybody = score()
    # Fewer than the features of the scene, so that a subset of them is searched.
    monkeypatch.setattr(subsets, "SUBSET_ROWS", 40)
    chosen = []
    monkeypatch.setattr(method, "choose_subset", lambda *a: chosen.append(choose_subset(*a)) or chosen[-1])
    assert np.nanmean(score()) > np.nanmean(everybody) - 0.02
    assert sum(not one.unexplained.all() for one in chosen) > len(chosen) / 2
