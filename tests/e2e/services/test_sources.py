"""A replay as a process; tests/unit/test_player.py has what pauses and late starts do."""

from itertools import pairwise

import numpy as np
import pytest

from comotion_schemas import Keys

KEYS = Keys()


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


def test_a_loop_is_a_new_session_and_a_late_joiner_gets_the_truth(start, endpoint, session, listen, take):
    observations = listen(session, KEYS.streams("obs"), "obs")
    statuses = listen(session, KEYS.stream("status", "cam"), "status")
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
    status = statuses.until(lambda one: one.rates["obs"] > 25 and one.counters["batches"] > 50)
    assert (status.role, status.state, status.rejected) == ("source", "ok", {})
    # The status may be taken between the two counters of one batch.
    assert 4 <= status.counters["observations"] / status.counters["batches"] <= 7.2
    assert status.ages["obs"] < 1.0
    assert process.interrupt() == 0
    assert "Traceback" not in process.output
