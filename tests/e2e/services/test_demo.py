"""``comotion demo``: from nothing to a result, ended early by Ctrl-C."""

import json
import re


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
