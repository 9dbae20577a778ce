"""`comotion view` on a live scene, into a file. Needs the extra `view`."""

import json
import subprocess
import sys

import pytest

from comotion_schemas import Keys

pytest.importorskip("rerun", reason="needs the extra view")
KEYS = Keys()


def test_a_live_scene_into_a_file(start, endpoint, session, listen, live_scene, tmp_path):
    statuses = listen(session, KEYS.streams("status"), "status")
    process = start("view", "--save", tmp_path / "a.rrd", "--connect", endpoint, "--json")
    shown = statuses.until(lambda s: s.role == "viewer" and s.counters.get("updates", 0) > 2)
    assert shown.ages["hypotheses"] < 30
    assert process.interrupt() == 0
    result = json.loads(process.output.partition("ready\n")[2])
    assert result["updates"] > 2
    assert result["dropped"] == 0
    command = [sys.executable, "-m", "rerun", "rrd", "print", tmp_path / "a.rrd"]
    printed = subprocess.run(command, check=True, capture_output=True, text=True)
    assert "/spaces/world/features/camera" in printed.stdout
