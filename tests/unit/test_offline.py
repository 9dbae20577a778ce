"""The core offline: the clock, the inputs, the table and the picture."""

import io
import json
import math

import numpy as np
import pytest
from rich.console import Console

from comotion import Fusion, FusionConfig
from comotion_experiments.evaluate import as_json, by_file, evaluate_inputs, table
from comotion_experiments.inputs import find_inputs
from comotion_experiments.offline import run_offline
from comotion_schemas import ObservationBatch
from comotion_schemas.codec import encode
from comotion_sources import simulator

from ..builders import TWO_BODIES

CONFIG = FusionConfig(method="thesis", thesis={"sigma_switch": 0.02, "v_move": None})


def messages(rates=None):
    return list(simulator.batches(simulator.simulate(simulator.load_scene(TWO_BODIES), seed=3, rates=rates)))


def test_every_update_sees_what_was_stamped_until_then():
    """The same as a plain loop over the clock, bit for bit."""
    sent = messages([15.0, 40.0])
    found: list[bytes] = []
    run_offline(sent, CONFIG, period=0.25, on_update=lambda u, _: found.append(encode(u)))

    fusion = Fusion(CONFIG)
    waiting = [m for m in sent if isinstance(m, ObservationBatch)]
    start, end = waiting[0].stamp_ns, waiting[-1].stamp_ns
    expected, now = [], start
    while now < end:
        now += 250_000_000
        while waiting and waiting[0].stamp_ns <= now:
            fusion.ingest(waiting.pop(0))
        expected.append(encode(fusion.update(now)))
    assert found == expected


@pytest.fixture
def recording(tmp_path):
    """Three markers at rest and three that move; one of each is not labelled."""
    rng = np.random.default_rng(0)
    times = np.arange(60) / 30
    positions = np.repeat(rng.uniform(0, 1, (1, 6, 3)), 60, axis=0)
    positions[:, 3:, 0] += 0.4 * times[:, None]
    path = tmp_path / "markers.npz"
    np.savez(path, positions=positions, times=times, labels=[1, 1, -1, 2, 2, -1])
    return path


def test_recordings_and_scenes_are_evaluated(recording):
    inputs = find_inputs([f"sim:{TWO_BODIES}", str(recording)], seeds=[0, 1])
    results = evaluate_inputs(inputs, CONFIG, period=0.25)
    scene = f"sim:{TWO_BODIES}"
    assert [(r.name, r.seed) for r in results] == [(scene, 0), (scene, 1), (str(recording), None)]
    assert all(r.run.summary.final_nmi == 1.0 for r in results)
    # The two markers without a label are grouped but never scored.
    assert results[2].run.summary.mean_objects == 2
    scenes = by_file(results)[scene]["mean_nmi"]
    assert scenes == pytest.approx((results[0].run.summary.mean_nmi + results[1].run.summary.mean_nmi) / 2)

    found = json.loads(json.dumps(as_json(results, CONFIG, 0.25), allow_nan=False))
    assert found["period"] == 0.25
    assert found["config"]["thesis"]["sigma_switch"] == 0.02
    assert [run["seed"] for run in found["runs"]] == [0, 1, None]
    assert found["overall"]["mean_nmi"] == pytest.approx((scenes + results[2].run.summary.mean_nmi) / 2)
    text = io.StringIO()
    Console(file=text, width=80).print(table(results))
    assert "overall" in text.getvalue()
    assert "± seeds" in text.getvalue()
    assert "ms/update" in text.getvalue().splitlines()[0]  # all columns of the short table fit
    everything = table(results, everything=True)
    assert set(table(results).titles) < set(everything.titles)
    assert {len(row) for row in everything.rows} == {len(everything.titles)}


def test_a_recording_without_truth_has_hypotheses_but_no_score(recording):
    with np.load(recording) as content:
        np.savez(recording, positions=content["positions"], times=content["times"])
    (result,) = evaluate_inputs(find_inputs([str(recording)]), CONFIG)
    assert math.isnan(result.run.summary.mean_nmi)
    assert result.run.summary.mean_hypotheses > 1
    assert as_json([result], CONFIG, None)["runs"][0]["mean_nmi"] is None
