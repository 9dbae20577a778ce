"""`comotion view` on a live scene: into a file, and as a page in a browser. Needs the extra `view`."""

import json
import os
import subprocess
import sys
import time
import urllib.request

import numpy as np
import pytest

from comotion_experiments.screens import CHROMIUM, opened
from comotion_schemas import HypothesisUpdate, Keys, SourceRef, encode
from comotion_schemas.colours import COLOURS
from comotion_schemas.transport import declare_publisher

from .. import builders
from ..builders import SESSION
from .tracker import every

pytest.importorskip("rerun", reason="needs the extra view")
KEYS = Keys("default")


def update(seq: int) -> HypothesisUpdate:
    now = time.time_ns()
    x, y = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12))
    return builders.update(
        [1] * 144,
        scene="default",
        seq=seq,
        stamp_ns=now,
        sources=[SourceRef(name="camera", session=SESSION)],
        track_position=np.stack([x.ravel(), y.ravel(), np.full(144, np.nan)], axis=1).astype(np.float32),
        hypotheses=[
            builders.hypothesis(1, space="wall", size=144, born_ns=now, state="static", centroid=[0.5, 0.5])
        ],
    )


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


@pytest.mark.timeout(300)
@pytest.mark.skipif(CHROMIUM not in os.environ, reason="needs the browser named by COMOTION_CHROMIUM")
def test_the_page_shows_features_in_the_colour_of_their_hypothesis(start, endpoint, scene):
    pytest.importorskip("playwright")
    from comotion_clients.viewing.sink import free_port

    ports = ("--port", free_port(), "--data-port", free_port())
    process = start("view", "--web", "--no-browser", "--connect", endpoint, *ports)
    url = process.wait_line(lambda line: line.startswith("look at ")).removeprefix("look at ")
    assert urllib.request.urlopen(url).status == 200
    with opened(f"{url}&renderer=webgl") as picture:
        end, found = time.monotonic() + 200, 0
        while time.monotonic() < end and found < 100:
            image = picture()[:, :, ::-1].astype(int)
            found = max(int((np.abs(image - rgb).max(axis=2) < 16).sum()) for rgb in COLOURS)
        assert found >= 100
    assert process.interrupt() == 0
