"""The simulator: the scenes are what the method's table says, and their truth holds."""

from collections import defaultdict

import numpy as np
import pytest

from comotion_schemas import ObservationBatch, TruthBatch, decode, encode
from comotion_sources.simulator import Simulation, batches, load_scene, scene_names, simulate

EPOCH_NS = 1_700_000_000_000_000_000

BODIES = {"background": 20, "body 1": 12, "body 2": 12}
SCENES = {
    # name: (features at the start by object, duration, features in all)
    "fig3_3": ({"R": 20, "G": 20, "P": 20, "Y": 20, "B": 20}, 9.0, 100),
    "fig3_6": ({"R": 3, "G": 3, "P": 3, "Y": 3, "B": 3}, 4.0, 15),
    "fig4_1": ({"R": 40, "G": 10}, 10.0, 50),
    "fig4_3": ({"R": 40, "G": 10}, 12.67, 50),
    "fig4_4": ({"R": 20, "G": 10, "P": 10}, 8.0, 64),
    "3d_2": ({"background": 20, "body 1": 12}, 12.0, 62),
    "3d_3": (BODIES, 12.0, 84),
    "3d_4": ({"background": 20, "body 1": 12, "body 2": 12, "body 3": 12}, 12.0, 106),
    "3d_5": ({"background": 20, "body 1": 8, "body 2": 8, "body 3": 8, "body 4": 8}, 12.0, 112),
    "3d_async": (BODIES, 12.0, 84),
    "3d_camera": (BODIES, 12.0, 84),
    "3d_gaps": (BODIES, 12.0, 84),
    "3d_late": (BODIES, 14.0, 92),
    "3d_outliers": (BODIES | {"outlier 1": 1, "outlier 2": 1}, 12.0, 86),
    "3d_pose": ({"background": 20, "body 1": 13, "body 2": 13}, 12.0, 86),
    "3d_rotation": (BODIES, 12.0, 84),
    "3d_static": ({"background": 44}, 12.0, 84),
}


def run(name, **options):
    return Simulation(load_scene(name), **options)


def objects_of(frames):
    return {i: o for f in frames for i, o in zip(f.ids.tolist(), f.objects.tolist(), strict=True)}


def test_every_tabulated_scene_ships():
    assert scene_names() == sorted(SCENES)


@pytest.mark.parametrize("name", sorted(SCENES))
def test_scene_has_the_tabulated_features(name):
    counts, duration, total = SCENES[name]
    simulation = run(name)
    frames = list(simulation)
    first = frames[0]
    names = simulation.objects
    present = objects_of(frames)
    born_at_start = {i: o for i, o in present.items() if i < sum(counts.values())}
    found = {n: sum(o == k for o in born_at_start.values()) for k, n in names.items()}
    assert found == counts
    assert len(present) == total
    assert first.t == 0.0
    assert frames[-1].t == pytest.approx(duration, abs=1 / 15)
    assert len(frames) == len(simulation)
    # One name for both would be refused by a service that has seen the other.
    assert simulation.spec.space == ("plane" if simulation.spec.dim == 2 else "world")
    assert simulation.spec.unit == "m"


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
    known, seq, last = defaultdict(dict), defaultdict(int), 0
    for message in batches(simulate(spec, rates=[15, 30, 100]), epoch_ns=EPOCH_NS):
        assert encode(decode(encode(message))) == encode(message)
        if isinstance(message, TruthBatch):
            known[message.source].update(zip(message.ids.tolist(), message.objects.tolist(), strict=True))
            continue
        assert isinstance(message, ObservationBatch)
        assert set(message.ids.tolist()) <= known[message.source].keys()
        assert message.stamp_ns >= max(last, EPOCH_NS)
        assert message.seq == seq[message.source]
        seq[message.source] += 1
        last = message.stamp_ns
    assert dict(seq) == {"simulator-1": 121, "simulator-2": 240, "simulator-3": 800}
    whole = objects_of(Simulation(spec))
    assert {i: o for part in known.values() for i, o in part.items()} == whole


def test_noise_is_published_on_demand_and_only_where_there_is_some():
    def sigmas(name, **options):
        messages = batches(run(name, publish_sigma=True, **options))
        return next(m.sigma for m in messages if isinstance(m, ObservationBatch))

    np.testing.assert_allclose(sigmas("fig4_1")[[0, -1]], [0.01, 0.005])
    assert sigmas("3d_2") == 0.003
    assert sigmas("fig3_6") is None
    assert next(m for m in batches(run("3d_2")) if isinstance(m, ObservationBatch)).sigma is None
