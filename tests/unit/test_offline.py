"""The core offline: inputs, tables and pictures; figures of the thesis and stress scenes, their pages."""

import io
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from comotion import FusionConfig
from comotion_deploy.cli import run
from comotion_deploy.commands import experiments
from comotion_experiments.evaluate import as_json, by_file, evaluate_inputs, table
from comotion_experiments.inputs import find_inputs
from comotion_experiments.stress.study import FAMILIES

from ..builders import TWO_BODIES

CONFIG = FusionConfig(method="thesis", thesis={"sigma_switch": 0.02, "v_move": None})


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
    (compared,) = evaluate_inputs(inputs[2:], CONFIG, comparator=True)
    assert compared.compared["spectral, K given"] == 1.0
    scenes = by_file(results)[scene]["mean_nmi"]
    assert scenes == pytest.approx((results[0].run.summary.mean_nmi + results[1].run.summary.mean_nmi) / 2)

    content = json.loads(json.dumps(as_json(results, CONFIG, 0.25), allow_nan=False))
    assert content["period"] == 0.25
    assert content["config"]["thesis"]["sigma_switch"] == 0.02
    assert [run["seed"] for run in content["runs"]] == [0, 1, None]
    assert content["overall"]["mean_nmi"] == pytest.approx((scenes + results[2].run.summary.mean_nmi) / 2)
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


def test_without_the_workcell_its_figures_are_left_out_and_the_page_stands_alone(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip("matplotlib", reason="needs the extra plot (matplotlib)")
    monkeypatch.setattr(experiments, "find_spec", lambda name: None)
    out = tmp_path / "new" / "figures"
    arguments = ["--only", "3.6", "--only", "4.6,4.9", "--seeds", "3", "--out", str(out)]
    assert run(["dev", "reproduce", *arguments]) == 0
    notice = "figures 4.6, 4.9 are left out; they need the workcell: pip install 'comotion[sim3d]'"
    captured = capsys.readouterr()
    assert notice in captured.out
    assert "[1/1] figure 3.6: fig3_6, default method, seed 3" in captured.err
    assert sorted(path.name for path in out.iterdir()) == ["fig3_6.png", "figures.json", "index.html"]
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "Figures 4.6, 4.9 are left out" in page
    assert "<code>comotion dev reproduce --only 3.6 --only 4.6,4.9 --seeds 3</code>" in page
    assert re.findall(r'<h2 id="(fig[^"]*)"', page) == ["fig3_6"]
    # Nothing is loaded from elsewhere.
    assert re.findall(r'(?:src|href)="(.{5})', page) == ["#fig3", "data:"]
    assert not re.search(r"https?:|@import|url\(|<script|<link", page)
    values = json.loads((out / "figures.json").read_text())
    assert values["left_out"] == ["4.6", "4.9"]
    rows = {row["quantity"]: row for row in values["figures"]["3.6"]["numbers"]}
    assert float(rows["affinity of B to Y at t = 4 s"]["thesis"]) < 0.01
    assert float(rows["affinity of B to G at t = 4 s"]["thesis"]) > 0.9
    assert rows["hypotheses at the end"]["default"] == "2"


def test_the_command_writes_a_page(tmp_path, capsys, monkeypatch) -> None:
    out = tmp_path / "out"
    family = FAMILIES["late_movers"]
    short = {**family.parameters, "first": 1.0, "every": 1.0, "duration": 4.0}
    monkeypatch.setitem(FAMILIES, "late_movers", replace(family, parameters=short))
    options = ["--family", "late_movers", "--seeds", "2", "--jobs", "1", "--json"]
    assert run(["dev", "reproduce", "stress", *options, "--out", str(out)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [(row["case"], row["setting"], row["seed"]) for row in shown["rows"]] == [
        ("late_movers", "comotion", 2),
        ("late_movers", "thesis", 2),
    ]
    page = (out / "stress.md").read_text()
    assert "| `late_movers` | start one after the other |" in page
    assert "1 of 45 families, seeds 2; even ones are for development" in " ".join(page.split())
