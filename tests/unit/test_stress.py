"""The command that runs stress scenes."""

import json
from dataclasses import replace

from comotion_deploy.cli import run
from comotion_experiments.stress import FAMILIES


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
