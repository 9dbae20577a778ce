"""A fleet of agents over real etcd: scenes are served, and go on when agents are lost, drained or added."""

import json
import logging
import os
import subprocess
import sys
import threading
import time
from contextlib import ExitStack

import pytest

from comotion.runtime.etcd import Etcd
from comotion_clients.subscription import Subscription
from comotion_deploy.fleet.entries import add_scene, read_fleet
from comotion_deploy.fleet.plan import Scene
from comotion_schemas import HypothesisUpdate, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import SessionSettings, stream_publisher

from .conftest import DEADLINE, observe
from .etcd_cluster import NEEDS_ETCD, EtcdCluster
from .test_service import is_sorted_out, labels

pytestmark = [pytest.mark.e2e, NEEDS_ETCD]
SCENES = int(os.environ.get("COMOTION_FLEET_SCENES", "2"))
"""How many scenes the fleet serves; 12 for the figures of docs/fleet.md."""


@pytest.fixture
def etcd(tmp_path):
    with EtcdCluster(tmp_path) as cluster:
        yield cluster


@pytest.fixture
def fleet(start, endpoint, etcd):
    """Start an agent: ``fleet(name)``."""
    return lambda name: start(
        "fleet", "--etcd", etcd.urls[0], "--capacity", 2 * SCENES, "--name", name, "--connect", endpoint
    )


@pytest.fixture
def sources(endpoint):
    """One tracker in each scene."""
    stop = threading.Event()

    def publish(scene):
        settings = SessionSettings(connect=(endpoint,))
        with Component(role="source", name="tracker", scene=scene, settings=settings) as component:
            publisher = stream_publisher(component.session, component.keys, "obs", "tracker")
            seq = 0
            while not stop.wait(0.05):
                publisher.put(encode(observe("tracker", component.session_id, seq, time.time_ns())))
                seq += 1

    threads = [threading.Thread(target=publish, args=(f"s{k}",), daemon=True) for k in range(SCENES)]
    for thread in threads:
        thread.start()
    yield
    stop.set()
    for thread in threads:
        thread.join(DEADLINE)


class Clients:
    """A subscriber in each scene; `gaps` are the longest times between two updates, s."""

    def __init__(self, session, stack):
        self.of = {
            f"s{k}": stack.enter_context(Subscription(session, HypothesisUpdate, f"s{k}"))
            for k in range(SCENES)
        }
        self.last = {}

    def until(self, condition):
        """Wait until the update of every scene is sorted out and `condition` holds; gaps by scene."""
        gaps = dict.fromkeys(self.of, 0.0)
        arrived = {}
        end = time.monotonic() + DEADLINE
        while time.monotonic() < end:
            for scene, subscription in self.of.items():
                for at, update in subscription.drain():
                    gaps[scene] = max(gaps[scene], at - arrived.get(scene, at))
                    arrived[scene], self.last[scene] = at, update
            found = len(self.last) == SCENES and all(map(is_sorted_out, self.last.values()))
            if found and len(arrived) == SCENES and condition():
                return gaps
            threading.Event().wait(0.1)
        raise AssertionError("what was awaited did not come")

    def labels(self):
        return {scene: labels(update) for scene, update in self.last.items()}


@pytest.fixture
def clients(session):
    with ExitStack() as stack:
        yield Clients(session, stack)


def settled(client, agents):
    """All places are held by these agents, and ready."""

    def check():
        found = read_fleet(client)
        held = found.held()
        return (
            len(held) == 2 * SCENES
            and all(holder.ready for holder in held.values())
            and {holder.agent for holder in held.values()} == agents
        )

    return check


def run(*arguments):
    words = [sys.executable, "-m", "comotion_deploy", "fleet", *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def test_scenes_survive_a_killed_agent_a_drain_and_a_new_agent(etcd, fleet, sources, clients):
    client, url = Etcd(etcd.urls), etcd.urls[0]
    agents = {name: fleet(name) for name in "abc"}
    assert run("add", "s0", "--etcd", url, "--", "--set", "window=7").returncode == 0
    for k in range(1, SCENES):
        add_scene(client, f"s{k}", Scene())
    clients.until(settled(client, set("abc") if SCENES > 1 else set("ab")))
    before = clients.labels()

    held = read_fleet(client).held()
    lost = max("abc", key=lambda name: sum(h.agent == name for h in held.values()))
    agents[lost].kill()
    others = set("abc") - {lost}
    after_kill = clients.until(settled(client, others))
    assert clients.labels() == before

    agents["d"] = fleet("d")
    drained = min(others)
    assert run("--etcd", url, "drain", drained).returncode == 0
    after_drain = clients.until(settled(client, (others | {"d"}) - {drained}))
    assert clients.labels() == before
    listed = json.loads(run("list", "--json", "--etcd", url).stdout)
    assert listed["agents"][drained] == {"replicas": 0, "capacity": 2 * SCENES, "draining": True}

    for name, gaps in (("kill", after_kill), ("drain", after_drain)):
        logging.getLogger(__name__).info("longest gap after %s: %.2f s", name, max(gaps.values()))
    assert run("remove", "s0", "--etcd", url).returncode == 0
    end = time.monotonic() + DEADLINE
    while any(place.scene == "s0" for place in read_fleet(client).holders):
        assert time.monotonic() < end
        threading.Event().wait(0.1)


def test_what_is_wrong_is_one_line(etcd):
    url = etcd.urls[0]
    for arguments, reason in [
        (("remove", "nothing", "--etcd", url), "there is no scene 'nothing'"),
        (("drain", "nobody", "--etcd", url), "there is no agent 'nobody'"),
        (("add", "Wrong Name", "--etcd", url), "a-z"),
        (("list",), "--etcd"),
        (("list", "--etcd", "http://127.0.0.1:1"), "etcd does not answer"),
    ]:
        done = run(*arguments)
        assert done.returncode == 2
        assert reason in done.stderr
        assert len(done.stderr.splitlines()) == 1
