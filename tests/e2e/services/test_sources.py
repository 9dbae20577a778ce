"""Simulator and replay as processes; tests/unit/test_player.py has what pauses and late starts do."""

import time
from itertools import pairwise

import numpy as np
import pytest

from comotion_schemas import Keys, ObservationBatch
from comotion_sources.recordings import read_recording, recording_batches
from comotion_sources.simulator import Simulation, load_scene

KEYS = Keys()

SCENE = """
title = "two bodies for a test"
dim = 2
duration = 2.0
respawn = { every = 1.0, share = 0.5 }

[[bodies]]
name = "R"
features = 8
size = [1.0, 1.0]
sigma = 0.0

[[bodies]]
name = "G"
features = 4
size = [0.2, 0.2]
sigma = 0.0
motion = { kind = "key-states", states = [[0.0, 0.0, 0.0, 0.0], [2.0, 1.0, 0.0, 3.0]] }
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def take(tmp_path):
    """A recording of 4 s at 50 Hz: two objects, a gap, an end."""
    rng = np.random.default_rng(0)
    positions = np.cumsum(rng.normal(0, 0.01, (200, 7, 3)), axis=0)
    positions[50:70, 2] = positions[120:, 4] = np.nan
    path = tmp_path / "take.npz"
    labels, names = np.array([1, 1, 2, 2, 1, -1, 2]), np.array(["arm", "hand"])
    np.savez(path, positions=positions, times=np.arange(200) / 50, labels=labels, segment_names=names)
    return path


def by_source(messages):
    result = {}
    for message in messages:
        result.setdefault(message.source, []).append(message)
    return result


def test_processes_divide_one_scene_and_agree_on_the_world(start, endpoint, session, listen, scene):
    observations = listen(session, KEYS.streams("obs"), "obs")
    truths = listen(session, KEYS.streams("truth"), "truth")
    # All must be ready before the scene begins; how long that takes is known afterwards.
    for delay in (5.0, 20.0, 80.0):
        begin = time.time() + delay
        common = ("--connect", endpoint, "--start-at", f"{begin:.3f}", "--seed", 3)
        parts = [("--part", f"{k}/3", "--rate", rate) for k, rate in ((1, 15), (2, 30), (3, 100))]
        processes = [start("source", "simulator", scene, *part, *common, ready=False) for part in parts]
        for process in processes:
            process.wait_ready()
        in_time = time.time() < begin
        for process in processes:
            assert process.wait() == 0, process.output
        messages, told = observations.drain(), truths.drain()
        if in_time:
            break
    sources = by_source(messages)
    assert set(sources) == {"simulator-1", "simulator-2", "simulator-3"}

    world = Simulation(load_scene(scene), seed=3, rate=1000.0, noise=0.0)
    instants = {round(frame.t, 3): frame for frame in world}
    objects = {i: o for frame in instants.values() for i, o in zip(frame.ids, frame.objects, strict=True)}
    owner = {}
    for source, batches in sources.items():
        assert len(batches) > 10
        for batch in batches:
            t = batch.stamp_ns / 1e9 - begin
            near = instants[round(min(t, 2.0), 3)]
            place = dict(zip(near.ids, near.positions, strict=True))
            for identity, position in zip(batch.ids, batch.positions, strict=True):
                assert owner.setdefault(identity, source) == source
                # Half a millisecond at up to 1 m/s, and the replacement of features at t = 1.
                if identity in place:
                    np.testing.assert_allclose(position, place[identity], atol=2e-3)
    assert set(owner) == set(objects)
    labels = {i: o for truth in told for i, o in zip(truth.ids, truth.objects, strict=True)}
    assert labels == objects


def test_a_replay_publishes_what_the_recording_yields(start, endpoint, session, listen, take):
    """Divided between sources of two rates; tests/unit/test_recordings.py has what else it yields."""
    observations = listen(session, KEYS.streams("obs"), "obs")
    options = ("--stamps", "original", "--speed", 4, "--rate", "25,10", "--split", 2)
    assert start("source", "replay", take, *options, "--connect", endpoint).wait() == 0
    expected = by_source(
        message
        for message in recording_batches(read_recording(take), split=2, rates=[25.0, 10.0])
        if isinstance(message, ObservationBatch)
    )
    found = by_source(observations.drain())
    assert found.keys() == expected.keys()
    for source, batches in found.items():
        # Zenoh may drop under load: what has arrived must be right, and most of it must arrive.
        assert len(batches) > 0.8 * len(expected[source])
        for batch in batches:
            wanted = expected[source][batch.seq]
            assert batch.stamp_ns == wanted.stamp_ns
            np.testing.assert_array_equal(batch.ids, wanted.ids)
            np.testing.assert_array_equal(batch.positions, wanted.positions)


def test_a_loop_is_a_new_session_and_a_late_joiner_gets_the_truth(start, endpoint, session, listen, take):
    observations = listen(session, KEYS.streams("obs"), "obs")
    process = start("source", "replay", take, "--connect", endpoint, "--speed", 8, "--loop", "--name", "cam")
    first = observations.next()
    observations.until(lambda batch: batch.session != first.session)
    seen = [observations.next() for _ in range(20)]
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(seen))
    # Joining now, the truth of sessions told before comes from the publisher's cache.
    truths = listen(session, KEYS.streams("truth"), "truth")
    truth = truths.until(lambda message: message.session == seen[-1].session)
    assert truth.names == {"1": "arm", "2": "hand"}
    assert truth.objects.tolist() == [1, 1, 2, 2, 1, -1, 2]
    assert process.interrupt() == 0
    assert "Traceback" not in process.output


def test_status_tells_rate_and_counters(start, endpoint, session, listen):
    statuses = listen(session, KEYS.stream("status", "cam"), "status")
    start("source", "simulator", "fig4_1", "--loop", "--rate", 50, "--name", "cam", "--connect", endpoint)
    status = statuses.until(lambda one: one.rates["obs"] > 25 and one.counters["batches"] > 50)
    assert (status.role, status.state, status.rejected) == ("source", "ok", {})
    # The status may be taken between the two counters of one batch.
    assert abs(status.counters["observations"] - 50 * status.counters["batches"]) <= 50
    assert status.counters["tracks"] == 50
    assert status.ages["obs"] < 1.0
    assert status.message == "simulates figure 4.1: an object crosses a noisy background"
