"""`comotion dev reproduce`: the figures of the thesis and the stress scenes, their pages and pictures."""

import json
import re
from dataclasses import replace

import pytest

pytest.importorskip("matplotlib", reason="needs the extra plot (matplotlib)")

from comotion_deploy.cli import run
from comotion_deploy.commands import experiments
from comotion_experiments.stress.study import FAMILIES


def test_without_the_workcell_its_figures_are_left_out_and_the_page_stands_alone(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(experiments, "find_spec", lambda name: None)
    out = tmp_path / "new" / "figures"
    arguments = ["--only", "3.6", "--only", "4.6,4.9", "--seeds", "3", "--out", str(out)]
    assert run(["dev", "reproduce", *arguments]) == 0
    said = "figures 4.6, 4.9 are left out; they need the workcell: pip install 'comotion[sim3d]'"
    captured = capsys.readouterr()
    assert said in captured.out
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
    assert "not all odd" in " ".join(page.split())
