"""The simulator: the scenes are what their files say, and their truth holds."""

from collections import Counter, defaultdict

import numpy as np
import pytest

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_sources.simulator import Simulation, batches, load_scene, scene_names, simulate

EPOCH_NS = 1_700_000_000_000_000_000


def run(name, **options):
    return Simulation(load_scene(name), **options)


def objects_of(frames):
    return {i: o for f in frames for i, o in zip(f.ids.tolist(), f.objects.tolist(), strict=True)}


@pytest.mark.parametrize("name", scene_names())
def test_a_scene_has_the_features_that_its_file_says_for_as_long(name):
    simulation = run(name)
    spec, frames = simulation.spec, list(simulation)
    declared: Counter[str] = Counter()
    for body in spec.bodies:
        declared[body.object or body.name] += body.features + body.poses
    names = simulation.objects
    at_first = [names[o] for i, o in objects_of(frames).items() if i < declared.total()]
    assert Counter(at_first) == declared
    assert (frames[0].t, len(frames)) == (0.0, len(simulation))
    assert frames[-1].t == pytest.approx(spec.duration, abs=1 / 15)
    # One name for both would be refused by a service that has seen the other.
    assert (spec.space, spec.unit) == ("plane" if spec.dim == 2 else "world", "m")


@pytest.mark.parametrize("split", ["features", "objects"])
@pytest.mark.parametrize("name", ["fig4_4", "3d_gaps", "3d_late", "3d_pose"])
def test_sources_of_any_rate_share_one_consistent_world(name, split):
    owners, objects = {}, {}
    for source in simulate(load_scene(name), seed=3, rates=[7.0, 25.0, 60.0], split=split):
        ended, frames = set(), list(source)
        assert len(frames) == len(source)
        for frame in frames:
            ids = frame.ids.tolist()
            assert np.isfinite(frame.positions).all()
            assert len(set(ids)) == len(ids)
            ended |= set(frame.ended.tolist())
            assert not ended & set(ids)
            for feature, number in zip(ids, frame.objects.tolist(), strict=True):
                assert owners.setdefault(feature, source.part) == source.part
                assert objects.setdefault(feature, number) == number


def test_noise_is_gaussian_of_the_stated_size_and_scaled_by_the_factor():
    exact = list(run("fig4_1", noise=0.0))
    for factor in (1.0, 2.0):
        noisy = list(run("fig4_1", noise=factor))
        error = np.stack([a.positions - b.positions for a, b in zip(noisy, exact, strict=True)])
        background = exact[0].objects == 0
        np.testing.assert_allclose(error[:, background].std(), 0.01 * factor, rtol=0.03)
        np.testing.assert_allclose(error[:, ~background].std(), 0.005 * factor, rtol=0.05)
        np.testing.assert_allclose(noisy[0].sigma[background], 0.01 * factor)


def test_the_same_seed_gives_the_same_frames_and_another_seed_others():
    def bits(seed):
        return [frame.positions.tobytes() for frame in run("3d_outliers", seed=seed)]

    assert bits(1) == bits(1)
    assert bits(1) != bits(2)


def test_batches_tell_the_truth_of_a_feature_before_its_first_observation():
    spec = load_scene("fig4_4")
    objects, seq, last = defaultdict(dict), defaultdict(int), 0
    for message in batches(simulate(spec, rates=[15, 30, 100]), epoch_ns=EPOCH_NS):
        assert encode(decode(encode(message))) == encode(message)
        if isinstance(message, TruthBatch):
            objects[message.source].update(zip(message.ids.tolist(), message.objects.tolist(), strict=True))
            continue
        assert isinstance(message, ObservationBatch)
        assert set(message.ids.tolist()) <= objects[message.source].keys()
        assert message.stamp_ns >= max(last, EPOCH_NS)
        assert message.seq == seq[message.source]
        seq[message.source] += 1
        last = message.stamp_ns
    assert dict(seq) == {"simulator-1": 121, "simulator-2": 240, "simulator-3": 800}
    whole = objects_of(Simulation(spec))
    assert {i: o for part in objects.values() for i, o in part.items()} == whole


def test_noise_is_published_on_demand_and_only_where_there_is_some():
    def sigmas(name, **options):
        messages = batches(run(name, publish_sigma=True, **options))
        return next(m.sigma for m in messages if isinstance(m, ObservationBatch))

    np.testing.assert_allclose(sigmas("fig4_1")[[0, -1]], [0.01, 0.005])
    assert sigmas("3d_2") == 0.003
    assert sigmas("fig3_6") is None
    assert next(m for m in batches(run("3d_2")) if isinstance(m, ObservationBatch)).sigma is None
