"""`comotion view` on a live scene, into a file. Needs the extra `view`."""

import json
import subprocess
import sys
import time

import pytest

from comotion_schemas import HypothesisUpdate, Keys, SourceRef, encode
from comotion_schemas.transport import declare_publisher

from .. import builders
from ..builders import SESSION
from .tracker import every

pytest.importorskip("rerun", reason="needs the extra view")
KEYS = Keys("default")


def update(seq: int) -> HypothesisUpdate:
    camera, body = SourceRef(name="camera", session=SESSION), builders.hypothesis(1, space="wall")
    now = time.time_ns()
    return builders.update([1], scene="default", seq=seq, stamp_ns=now, sources=[camera], hypotheses=[body])


@pytest.fixture
def scene(session):
    """A service, at 10 Hz."""
    hypotheses = declare_publisher(session, KEYS.hypotheses, "hypotheses")
    with every(0.1, lambda seq: hypotheses.put(encode(update(seq)))):
        yield


def test_a_live_scene_into_a_file(start, endpoint, session, listen, scene, tmp_path):
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
    assert "/spaces/wall/features/camera" in printed.stdout
