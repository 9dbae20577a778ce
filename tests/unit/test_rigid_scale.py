"""The rigid method on many trajectories, and between fits: bounded work finds what all of it would."""

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

from ..builders import batch, labels_of

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


HZ, SPIN, WAY = 30, np.array([0.0, 0.3, 0.8]), np.array([0.12, -0.05, 0.0])
# Ten features at rest, ten that rest until they move, ten that always move.
REST, LATE, MOVING = np.arange(10), np.arange(10, 20), np.arange(20, 30)


def positions(t, late_s, rng):
    centres = np.repeat([[-1, 0, 0], [0, 1, 0], [1, 0, 0]], [10, 10, 11], 0)
    place = np.random.default_rng(3).uniform(-0.3, 0.3, (31, 3)) + centres
    for members, since in ((LATE, late_s), (np.arange(20, 31), 0.0)):
        s = max(t - since, 0.0)
        place[members] = Rotation.from_rotvec(SPIN * s).apply(place[members]) + WAY * s
    return place + rng.normal(0, 0.002, place.shape)


def run(monkeypatch, seconds, *, late_s=np.inf, born_s=np.inf, end_s=np.inf, holding=True):
    """(time, whether the last fit was held, update) at 10 Hz.

    Feature 30 is born on the moving body, feature 29 of it ends.
    """
    held, rng, fusion = [], np.random.default_rng(1), Fusion(FusionConfig())
    original = method.held

    def recorded(*args):
        held.append(original(*args) if holding else None)
        return held[-1]

    with monkeypatch.context() as patched:
        patched.setattr(method, "held", recorded)
        for frame in range(int(seconds * HZ)):
            t = frame / HZ
            ids = np.array([i for i in range(31) if (i != 30 or t >= born_s) and (i != 29 or t < end_s)])
            x, stamp_ns = positions(t, late_s, rng)[ids], START + frame * 10**9 // HZ
            fusion.ingest(batch("camera", frame, stamp_ns, x, ids=ids.astype(np.uint64)))
            if frame % 3 == 2:
                update = fusion.update(stamp_ns)
                yield t, bool(held) and held[-1] is not None, update


def apart(update, some, others):
    labels = labels_of(update)
    mine, theirs = ({labels.get(int(i), -1) for i in one} for one in (some, others))
    return not mine & theirs


def test_a_steady_scene_is_held_mostly_with_the_motion_of_now(monkeypatch):
    shares = []
    for t, held, update in run(monkeypatch, 9):
        if t > 6:
            shares.append(held)
            assert apart(update, MOVING, REST)
            (moving,) = (h for h in update.hypotheses if h.twist is not None and h.state == "moving")
            assert np.linalg.norm(np.array(moving.twist.angular) - SPIN) < 0.1
    assert np.mean(shares) > 0.6


def test_what_begins_to_move_is_found_as_soon_as_by_a_fit_at_each_update(monkeypatch):
    found = {}
    for holding in (True, False):
        found[holding] = next(
            t
            for t, _, update in run(monkeypatch, 9, late_s=6.0, holding=holding)
            if t > 6.0 and apart(update, LATE, REST)
        )
    assert found[True] <= found[False] + 0.1 + 1e-9


def test_a_feature_that_is_born_joins_its_body_while_the_fit_is_held(monkeypatch):
    joined = [
        held and labels_of(update).get(30) == labels_of(update)[int(MOVING[0])]
        for t, held, update in run(monkeypatch, 8, born_s=6.0)
        if t >= 6.0
    ]
    assert any(joined[:6])


def test_a_feature_that_ends_is_gone_while_the_fit_is_held(monkeypatch):
    updates = [(held, labels_of(update)) for t, held, update in run(monkeypatch, 8, end_s=6.0) if t > 6.7]
    assert any(held for held, _ in updates)
    assert all(set(labels) == set(range(29)) for _, labels in updates)
