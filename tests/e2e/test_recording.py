"""A three-source scene recorded, replayed, evaluated offline, and a recorder that is killed."""

import hashlib
import json
import re
import signal
import urllib.request
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import make_reader

from comotion import FusionConfig
from comotion_deploy.cli import run
from comotion_experiments.inputs import find_inputs
from comotion_experiments.offline import run_offline
from comotion_schemas import Keys, Status, decode, encode

from .waiting import DEADLINE, until_heard

KEYS = Keys()
ROOT = Path(__file__).parents[2]
PERIOD = 0.25
"""s between offline updates: enough of them, and quick."""


def read(path: Path) -> dict[str, list[bytes]]:
    """Payloads by key, in the order of receipt."""
    payloads: dict[str, list[bytes]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            payloads.setdefault(channel.topic, []).append(message.data)
    return payloads


def of_sources(payloads: dict[str, list[bytes]]) -> dict[str, list[bytes]]:
    return {key: sent for key, sent in payloads.items() if "/obs/" in key or "/truth/" in key}


def evaluated(path: Path, *, as_received: bool = False) -> list[bytes]:
    (scene,) = find_inputs([str(path)], as_received=as_received)
    updates: list[bytes] = []
    run_offline(
        scene.open(),
        FusionConfig(),
        period=PERIOD,
        on_update=lambda update, _: updates.append(encode(update)),
    )
    return updates


@pytest.fixture
def recorded(start, endpoint, session, listen, tmp_path):
    """A short scene of three sources and a service, with one payload that is no message."""
    path = tmp_path / "take.mcap"
    statuses = listen(session, KEYS.stream("status", "recorder"), "status")
    of_service = listen(session, KEYS.stream("status", "fusion"), "status")
    service = start("serve", "--metrics-port", "0", "--connect", endpoint)
    recorder = start("record", path, "--connect", endpoint)
    metrics = ("--metrics-port", "127.0.0.1:0")
    source = start("source", "simulator", "3d_async", *metrics, "--connect", endpoint)
    until_heard(session.declare_publisher(KEYS.stream("obs", "noise"))).put(b"nonsense")
    reported: Status = statuses.until(lambda s: s.counters["messages"] > 600 and s.rejected)
    # Two Statuses later the first of them is what a scrape tells.
    for _ in range(2):
        of_service.until(lambda s: s.rejected and s.counters["updates"] > 5 and len(s.ages) == 3)
    check_metrics(*(scrape(process) for process in (service, source)))
    assert source.interrupt() == 0
    assert reported.role == "recorder"
    assert reported.rejected == {"malformed": 1}
    assert reported.rates["hypotheses"] > 0
    assert recorder.interrupt() == 0
    assert "recorded although invalid: 1 malformed" in recorder.lines
    return path


def scrape(process) -> str:
    line = process.wait_line(lambda line: line.startswith("metrics at http://127."))
    with urllib.request.urlopen(line.removeprefix("metrics at "), timeout=DEADLINE) as reply:
        return reply.read().decode()


def check_metrics(service: str, source: str) -> None:
    """All that the dashboard shows is there."""
    reported = f"{service}\n{source}"
    labels = 'component="fusion",reason="malformed",role="service",scene="default"'
    assert f"comotion_rejected_total{{{labels}}} 1.0" in reported
    assert 'comotion_publish_lag_seconds_count{component="simulator-3"' in reported
    dashboard = json.loads((ROOT / "deploy" / "grafana-dashboard.json").read_text())
    queries = [t["expr"] for panel in dashboard["panels"] for t in panel["targets"]]
    names = {word for query in queries for word in re.findall(r"(?:comotion|process)_\w+", query)}
    assert len(names) > 10
    for name in sorted(names):
        assert f"\n{name}" in reported, name
    assert service.count("\ncomotion_tick_seconds_count") == 1
    assert "\ncomotion_tick_seconds_count" not in source


def test_a_scene_is_recorded_measured_replayed_and_evaluated(start, endpoint, recorded, tmp_path):
    first = read(recorded)
    sources = of_sources(first)
    assert first[KEYS.stream("obs", "noise")] == [b"nonsense"]
    kinds = Counter(key.split("/")[3] for key in first)
    assert kinds == {"obs": 4, "truth": 3, "hypotheses": 1, "status": 5}

    # Offline: the same updates, in this process twice and in a fresh one with other hash seeds.
    updates = evaluated(recorded)
    assert len(updates) >= 10
    assert evaluated(recorded) == updates
    assert evaluated(recorded, as_received=True) == evaluated(recorded, as_received=True)
    words = ("evaluate", recorded, "--json", "--period", PERIOD)
    fresh = start(*words, ready=False, env={"PYTHONHASHSEED": "77"})
    assert fresh.wait() == 0
    (summary,) = json.loads(fresh.output[fresh.output.index("{\n") :])["runs"]
    assert summary["updates_sha256"] == hashlib.sha256(b"".join(updates)).hexdigest()

    # Live: published again byte for byte, which a second recorder notes.
    again = tmp_path / "again.mcap"
    recorder = start("record", again, "--name", "second", "--connect", endpoint)
    how = ("--stamps", "original", "--speed", 2, "--connect", endpoint)
    assert start("source", "replay", recorded, *how, ready=False).wait() == 0
    assert recorder.interrupt() == 0
    second = of_sources(read(again))
    assert second.keys() == sources.keys()
    for key, payloads in second.items():
        # A loaded machine may lose a batch on the way; what came is what was sent, in its order.
        sent = iter(sources[key])
        assert all(payload in sent for payload in payloads)
        assert len(payloads) >= 0.9 * len(sources[key])
    if second == sources:
        assert evaluated(again) == updates


def test_a_killed_recorder_keeps_what_it_held_before_the_last_flush(
    start, endpoint, session, listen, tmp_path
):
    path = tmp_path / "take.mcap"
    statuses = listen(session, KEYS.stream("status", "recorder"), "status")
    recorder = start("record", path, "--connect", endpoint)
    start("source", "simulator", "3d_async", "--loop", "--connect", endpoint)
    held = statuses.until(lambda status: status.counters["messages"] > 100).counters
    # The first growth may be of a flush that had begun before.
    written = held["bytes"]
    for _ in range(2):
        grown = statuses.until(lambda status, least=written: status.counters["bytes"] > least)
        written = grown.counters["bytes"]
    recorder.signal(signal.SIGKILL)
    assert recorder.wait() == -signal.SIGKILL

    assert start("record", "--repair", path, ready=False).wait() == 0
    repaired = read(tmp_path / "take-repaired.mcap")
    assert sum(map(len, repaired.values())) >= held["messages"]
    saved = [decode(payload) for payload in repaired[KEYS.stream("obs", "simulator-3")]]
    assert [batch.seq for batch in saved] == sorted({batch.seq for batch in saved})
    assert len(saved) >= 0.9 * (saved[-1].seq - saved[0].seq + 1)


def test_a_scene_that_is_not_there_is_no_recording(endpoint, tmp_path, capsys):
    options = ("--scene", "typo", "--duration", "0.3", "--connect", endpoint)
    assert run(["record", str(tmp_path / "x.mcap"), *options]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error == "error: no message was received in scene 'typo': nothing was recorded"
    assert list(tmp_path.iterdir()) == []
