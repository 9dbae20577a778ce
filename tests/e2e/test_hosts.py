"""Three hosts as network namespaces, with a bad network between them: routers meshed with certificates.

Sources on A; the service of one scene on B, of another on C; clients on all. Between hosts everything goes
through a relay that delays by 50 ms, jitters and loses datagrams. A link is cut for 5 s and routers are
killed: output resumes by itself, counters tell what was lost, ids survive.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.grants import Grant

from .conftest import Process

pytestmark = [pytest.mark.e2e, pytest.mark.long]
HOSTS = ("a", "b", "c")
SCENES = {"one": "b", "two": "c"}
QUIC = 7447
CUT_S = 5.0
RATE = 20.0
FIRST = 3
"""Batches that may be published before the service hears the source."""
SOURCE = """
import sys, time
import numpy as np
from comotion_schemas import ObservationBatch, encode
from comotion_schemas.component import Component
from comotion_schemas.transport import client_settings, stream_publisher

scene, folder = sys.argv[1:]
rng = np.random.default_rng(7)
rest = rng.random((12, 3)) * 0.4
name = f"tracker-{scene}"
settings = client_settings(["tls/127.0.0.1:7447"], folder)
with Component(role="source", name=name, scene=scene, settings=settings) as source:
    publisher = stream_publisher(source.session, source.keys, "obs", name)
    while not publisher.matching_status.matching:
        time.sleep(0.05)
    sent = 0
    while not source.stop.wait(0.05):
        now = time.time()
        swing = 0.3 * np.sin(np.pi * now)
        positions = rest + rng.normal(0, 0.001, rest.shape)
        positions[:6, 0] += swing
        positions[6:, 1] += 1.0 + swing
        publisher.put(encode(ObservationBatch(
            source=name, session=source.session_id, seq=sent, space="world", unit="m", dim=3,
            stamp_ns=int(now * 1e9), ids=np.arange(12, dtype=np.uint64), positions=positions)))
        sent += 1
    time.sleep(1.0)  # the last batch arrives before the presence ends
print(f"sent {sent}", flush=True)
"""


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def why_not() -> str:
    """Why namespaces cannot be made here; empty if they can."""
    if sys.platform != "linux" or shutil.which("ip") is None:
        return "no 'ip'"
    probe = f"comotion-probe-{os.getpid()}"
    try:
        ip("netns", "add", probe)
    except subprocess.CalledProcessError as error:
        return f"network namespaces are not permitted: {error.stderr.strip()}"
    try:
        ip("-n", probe, "link", "add", "x", "type", "veth", "peer", "name", "y")
    except subprocess.CalledProcessError as error:
        return f"no virtual links: {error.stderr.strip()}"
    finally:
        ip("netns", "del", probe)
    return ""


class Network:
    """Three hosts, each linked to the namespace of the relay alone."""

    def __init__(self, stack: ExitStack) -> None:
        self._prefix = f"comotion-{os.getpid()}-"
        for name in ("relay", *HOSTS):
            ip("netns", "add", self.namespace(name))
            stack.callback(ip, "netns", "del", self.namespace(name))
            ip("-n", self.namespace(name), "link", "set", "lo", "up")
        for number, host in enumerate(HOSTS, 1):
            near, far = self.namespace(host), self.namespace("relay")
            ip("-n", far, "link", "add", f"to-{host}", "type", "veth", "peer", "name", "out", "netns", near)
            ip("-n", far, "address", "add", f"10.99.{number}.1/24", "dev", f"to-{host}")
            ip("-n", near, "address", "add", f"10.99.{number}.2/24", "dev", "out")
            ip("-n", near, "link", "set", "out", "up")
            self.set_link(host, "up")

    def namespace(self, host: str) -> str:
        return self._prefix + host

    def on(self, host: str) -> tuple[str, ...]:
        """Words before a command that is to run on a host."""
        return ("ip", "netns", "exec", self.namespace(host))

    def set_link(self, host: str, state: str) -> None:
        ip("-n", self.namespace("relay"), "link", "set", f"to-{host}", state)


def address(host: str, *, of_relay: bool = False) -> str:
    return f"10.99.{HOSTS.index(host) + 1}.{1 if of_relay else 2}"


def port(near: str, far: str) -> int:
    """Where the relay listens for a link between two hosts."""
    return 9000 + 10 * HOSTS.index(near) + HOSTS.index(far)


class Site:
    """The network with its certificates, routers, services, sources and clients."""

    def __init__(self, network: Network, folder: Path, run: Callable[..., Process]) -> None:
        self.network, self._run = network, run
        self.pki = folder / "pki"
        authority = Authority.create(self.pki)
        names = ["localhost", "127.0.0.1", *(address(host, of_relay=True) for host in HOSTS)]
        for host in HOSTS:
            authority.issue(grant("router", f"router-{host}"), hosts=names)
            authority.issue(grant("viewer", f"viewer-{host}", scene="*"))
        for scene in SCENES:
            authority.issue(grant("service", f"fusion-{scene}", scene=scene))
            authority.issue(grant("source", f"tracker-{scene}", scene=scene))
        self._relay()
        self.routers = {host: self.router(host) for host in HOSTS}
        services = [self._service(scene, host) for scene, host in SCENES.items()]
        for process in services:
            process.wait_ready()
        script = folder / "source.py"
        script.write_text(SOURCE)
        self.sources = {
            scene: self._run("a", sys.executable, script, scene, self.pki / f"tracker-{scene}")
            for scene in SCENES
        }
        # On every host a client of a scene that is served elsewhere.
        self.clients = {(h, s): self.client(h, s) for h, s in [("a", "one"), ("b", "two"), ("c", "one")]}

    def _relay(self) -> None:
        pairs = [("b", "a"), ("c", "a"), ("c", "b")]
        links = [
            {"listen": [address(near, of_relay=True), port(near, far)], "target": [address(far), QUIC]}
            for near, far in pairs
        ]
        spec = {"links": links, "delay_s": 0.05, "jitter_s": 0.01, "loss": 0.01}
        relay = Path(__file__).with_name("relay.py")
        self._run("relay", sys.executable, relay, json.dumps(spec)).wait_ready()

    def router(self, host: str) -> Process:
        others = [other for other in HOSTS if other < host]
        connect = [
            word
            for other in others
            for word in ("--connect", f"quic/{address(host, of_relay=True)}:{port(host, other)}")
        ]
        listen = ("--listen", "tls/127.0.0.1:7447", "--listen", f"quic/{address(host)}:{QUIC}")
        own = ("--secure", self.pki, "--tls", self.pki / f"router-{host}")
        process = self.comotion(host, "router", *own, *listen, *connect)
        process.wait_ready()
        return process

    def comotion(self, host: str, *words: object) -> Process:
        return self._run(host, sys.executable, "-m", "comotion_deploy", *words)

    def _service(self, scene: str, host: str) -> Process:
        tls = self.pki / f"fusion-{scene}"
        return self.comotion(host, "serve", "--no-state", "--scene", scene, "--tls", tls)

    def client(self, host: str, scene: str) -> Process:
        tls = self.pki / f"viewer-{host}"
        return self.comotion(host, "watch", "--json", "--scene", scene, "--tls", tls)


def grant(role: str, name: str, scene: str = "*") -> Grant:
    sources = (name,) if role == "source" else ()
    return Grant(role=role, name=name, common_name="new", scene=scene, sources=sources)


@pytest.fixture
def site(tmp_path: Path, spawn: Callable[..., Process], start: object) -> Iterator[Site]:
    # `start` is asked for because the kernels are then compiled before any deadline runs.
    reason = why_not()
    if reason:
        pytest.skip(reason)
    with ExitStack() as stack:
        network = Network(stack)

        def run(host: str, *command: object) -> Process:
            process = spawn(*network.on(host), *command)
            stack.callback(process.close)
            return process

        yield Site(network, tmp_path, run)


def bodies(line: str) -> set[int]:
    """Ids of both bodies if a line of a client shows them at their present places; else nothing."""
    shown = json.loads(line) if line.startswith("{") else {}
    well = bool(shown) and shown["service"]["state"] != "silent" and shown["service"]["age"] < 1.0
    rows = shown.get("hypotheses", [])
    present = {row["id"] for row in rows if row["size"] == 6 and row["confirmed"] and not row["absent"]}
    live = any(source["state"] == "ok" for source in shown.get("sources", []))
    return present if well and live and len(present) == 2 else set()


def seen(site: Site) -> dict[tuple[str, str], set[int]]:
    """Ids that each client shows from now on, once it shows both bodies."""
    found = {}
    for key, client in site.clients.items():
        line = client.wait_line(lambda text: bool(bodies(text)), start=len(client.lines))
        found[key] = bodies(line)
    return found


def until_counted(site: Site, scene: str, condition: Callable[[dict[str, int]], object]) -> dict[str, int]:
    """The first counters of a service from now on, as a client shows them, that fulfil a condition."""
    client = next(client for (_, served), client in site.clients.items() if served == scene)

    def counters(line: str) -> dict[str, int]:
        return json.loads(line)["service"]["counters"] if line.startswith("{") else {}

    found = client.wait_line(lambda line: condition(counters(line)) if counters(line) else False)
    return counters(found)


def accounts_for(sent: int, now: dict[str, int]) -> bool:
    """Whether counters tell how many batches never came, but for a few.

    The service counts from the first batch that it sees. When routes change, a batch that others overtake
    counts as lost before it comes, and one may come twice.
    """
    few = FIRST + now["duplicates"] + now["reordered"] + now["late"]
    return abs(sent - now["batches"] - now["lost"]) <= few


def test_a_scene_over_three_hosts_survives_its_network(site: Site) -> None:
    before = seen(site)
    assert before["a", "one"] == before["c", "one"]

    site.network.set_link("a", "down")
    time.sleep(CUT_S)
    site.network.set_link("a", "up")
    assert seen(site) == before, "after the link was cut"
    # What was published meanwhile did not arrive, and is counted.
    for scene in SCENES:
        until_counted(site, scene, lambda now: now.get("lost", 0) > 0)

    for host in ("a", "b"):
        site.routers[host].kill()
        site.routers[host] = site.router(host)
        assert seen(site) == before, f"after the router of host {host} was killed"

    for scene, source in site.sources.items():
        source.popen.terminate()
        sent = int(source.wait_line(lambda line: line.startswith("sent ")).split()[1])
        now = until_counted(site, scene, lambda now, sent=sent: accounts_for(sent, now))
        assert now["lost"] > 0.9 * CUT_S * RATE
