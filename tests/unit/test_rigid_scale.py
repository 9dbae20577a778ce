"""The rigid method on many trajectories, and between fits: bounded work finds what all of it would."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig
from comotion.rigid import method, search
from comotion.rigid import subset as subsets
from comotion.rigid.subset import choose_subset
from comotion_experiments.offline import run_offline
from comotion_sources import simulator
from comotion_tools.bench import SceneSpec, messages

from ..builders import batch, labels_of

START = 10**12


def test_two_thousand_are_grouped():
    stream = messages(SceneSpec(features=2000, sources=1, rate=15.0), 3.0)
    scores = run_offline(stream, FusionConfig(), period=1 / 3).scores
    assert min(score.nmi for score in scores) > 0.99
    assert {score.hypotheses for score in scores} == {7}


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
    monkeypatch.setattr(search, "choose_subset", lambda *a: chosen.append(choose_subset(*a)) or chosen[-1])
    assert np.nanmean(score()) > np.nanmean(everybody) - 0.02
    assert min(map(len, chosen)) <= 40


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


def apart(update, features, others):
    labels = labels_of(update)
    hypotheses = [{labels.get(int(i), -1) for i in group} for group in (features, others)]
    return not set.intersection(*hypotheses)


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
    seen_s = {}
    for holding in (True, False):
        seen_s[holding] = next(
            t
            for t, _, update in run(monkeypatch, 9, late_s=6.0, holding=holding)
            if t > 6.0 and apart(update, LATE, REST)
        )
    assert seen_s[True] <= seen_s[False] + 0.1 + 1e-9


def test_what_is_born_joins_its_body_and_what_ends_is_gone_while_the_fit_is_held(monkeypatch):
    updates = list(run(monkeypatch, 8, born_s=6.0, end_s=6.0))
    born = [(held, labels_of(update)) for t, held, update in updates if t >= 6.0]
    assert any(held and labels.get(30) == labels[int(MOVING[0])] for held, labels in born[:6])
    later = [(held, labels_of(update)) for t, held, update in updates if t > 6.7]
    assert any(held for held, _ in later)
    assert all(set(labels) == {*range(29), 30} for _, labels in later)
