"""Scores of a running scene: `comotion demo` from nothing, and `comotion evaluate` as it is offline."""

import json
import re
from collections import Counter

import pytest

from comotion import FusionConfig
from comotion_clients import evaluate as live
from comotion_deploy.cli import run
from comotion_experiments.evaluate import evaluate_inputs
from comotion_experiments.inputs import find_inputs
from comotion_schemas import Keys

from ...builders import TWO_BODIES


def test_the_demo_ends_with_a_summary_and_a_plot_on_ctrl_c(start, tmp_path):
    # A folder of certificates for another scene is not for the demo.
    env = {"COMOTION_TLS": str(tmp_path / "pki" / "me"), "COMOTION_METRICS_PORT": "1"}
    demo = start("demo", "--out", tmp_path / "out", ready=False, env=env)
    assert "does not use COMOTION_TLS, COMOTION_METRICS_PORT" in demo.wait_line(lambda line: "own" in line)
    demo.wait_line(lambda line: "all processes are ready" in line)
    demo.wait_line(lambda line: re.search(r"watch \| .* 44 tracks [2-9] hypotheses", line) is not None)
    assert demo.interrupt() == 0
    assert "mean NMI" in demo.output
    assert "NMI over time" in demo.output
    assert (tmp_path / "out" / "demo.png").read_bytes().startswith(b"\x89PNG")
    values = json.loads((tmp_path / "out" / "demo.json").read_text())
    assert values["scored"] > 0
    # A loaded machine may lose an update on the way.
    assert values["lost"] <= 0.1 * values["updates"]
    assert len(values["over_time"]) == values["updates"]


SETTINGS = ("--set", "thesis.sigma_switch=0.02", "--set", "thesis.v_move=null")


def test_live_agrees_with_offline(start, endpoint, session, listen, tmp_path):
    updates = listen(session, Keys().hypotheses, "hypotheses")
    plot, ready = tmp_path / "live.png", tmp_path / "ready"
    connect = ("--connect", endpoint)
    start("serve", *SETTINGS, *connect)
    live = start("evaluate", "--json", "--plot", plot, "--ready-file", ready, *connect, ready=False)
    live.wait_line(lambda line: "waiting" in line or "updates" in line)
    assert start("source", "simulator", TWO_BODIES, *connect).wait() == 0
    stamps = Counter()

    def has_ended(update):
        """Once the source has ended, updates repeat their stamp."""
        stamps[update.stamp_ns] += bool(len(update.track_id))
        return stamps[update.stamp_ns] >= 5

    updates.until(has_ended)
    assert live.interrupt() == 0

    scored = json.loads(live.output[live.output.index("{") :])
    (offline,) = evaluate_inputs(
        find_inputs([f"sim:{TWO_BODIES}"]),
        FusionConfig(method="thesis", thesis={"sigma_switch": 0.02, "v_move": None}),
    )
    assert scored["lost"] == 0
    assert scored["final_nmi"] == offline.run.summary.final_nmi == 1.0
    # Updates fall on other instants; the one at which the bodies part weighs a twentieth.
    assert scored["mean_nmi"] == pytest.approx(offline.run.summary.mean_nmi, abs=0.1)
    # The wait at the end, with no source left, is not scored.
    stamps = [row["stamp_ns"] for row in scored["over_time"]]
    assert stamps == sorted(set(stamps))
    assert plot.stat().st_size > 10_000
    assert not ready.exists()


def test_a_scene_that_nobody_serves_is_one_clear_line(endpoint, monkeypatch, capsys):
    monkeypatch.setattr(live, "FIRST_UPDATE_TIMEOUT_S", 0.6)
    assert run(["evaluate", "--connect", endpoint, "--duration", "0.5", "--scene", "typo"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == "error: no update was received in scene 'typo': is the service running?"
