"""Three hosts as network namespaces, with a bad network between them: routers meshed with certificates.

Sources on A; two replicas of their scene on B and C; clients on all; etcd on a fourth host. Routers reach
each other through a relay that delays by 50 ms, jitters and loses datagrams. The host of the sources and that
of the active replica are cut off for 5 s, and routers are killed: output resumes by itself, counters tell
what was lost, ids survive.
"""

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path

import pytest

from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.grants import Grant

from . import tracker
from .conftest import Process
from .etcd_cluster import NEEDS_ETCD
from .tracker import until

pytestmark = [pytest.mark.long, NEEDS_ETCD]
HOSTS = ("a", "b", "c")
REPLICAS = ("b", "c")
SCENE = "cell"
SOURCES = ("left", "right")
QUIC = 7447
CUT_S = 5.0
RATE = 20.0
FIRST = 3
"""Batches that may be published before the service hears the source."""


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
    """The network with its certificates, routers, etcd, replicas, sources and clients."""

    def __init__(self, network: Network, folder: Path, run: Callable[..., Process]) -> None:
        self.network, self._run = network, run
        self.pki = folder / "pki"
        self._issue()
        self._relay()
        self._etcd(folder / "etcd")
        self.routers = {host: self.router(host) for host in HOSTS}
        replicas = [self._replica(host) for host in REPLICAS]
        for process in (*self.routers.values(), *replicas):
            process.wait_ready()
        self.sources = [self._source(name) for name in SOURCES]
        self.clients = {host: self._client(host) for host in HOSTS}

    def _issue(self) -> None:
        authority = Authority.create(self.pki)
        names = ["localhost", "127.0.0.1", *(address(host, of_relay=True) for host in HOSTS)]
        for host in HOSTS:
            authority.issue(grant("router", f"router-{host}"), hosts=names)
            authority.issue(grant("viewer", f"viewer-{host}"))
        for host in REPLICAS:
            authority.issue(grant("service", f"fusion-{host}"))
        for name in SOURCES:
            authority.issue(grant("source", name))
        authority.issue(grant("viewer", "operator"))

    def _etcd(self, folder: Path) -> None:
        """On the host of the relay: whoever is cut off does not reach it."""
        urls = [f"http://{address(host, of_relay=True)}:2379" for host in HOSTS]
        listen = ("--listen-client-urls", ",".join(urls), "--advertise-client-urls", urls[0])
        self._run("relay", "etcd", "--data-dir", folder, "--log-level", "error", *listen)

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
        return self.comotion(host, "router", *own, *listen, *connect)

    def comotion(self, host: str, *words: object) -> Process:
        return self._run(host, sys.executable, "-m", "comotion_deploy", *words)

    def _replica(self, host: str) -> Process:
        own = ("--name", f"fusion-{host}", "--tls", self.pki / f"fusion-{host}")
        standby = ("--standby", "--etcd", f"http://{address(host, of_relay=True)}:2379")
        return self.comotion(host, "serve", "--no-state", "--scene", SCENE, *own, *standby)

    def _source(self, name: str) -> Process:
        own = {"name": name, "tls": str(self.pki / name), "seed": len(name), "noise": 0.001}
        at = {"endpoint": f"tls/127.0.0.1:{QUIC}", "scene": SCENE, "rate": RATE}
        # The last batch arrives before the presence ends.
        options = json.dumps(own | at | {"stays_s": 1.0})
        return self._run("a", sys.executable, tracker.__file__, options)

    def _client(self, host: str) -> Process:
        tls = self.pki / f"viewer-{host}"
        return self.comotion(host, "watch", "--json", "--scene", SCENE, "--tls", tls)

    def replicas(self) -> dict[str, tuple[str, int]]:
        """Role and epoch of each replica, by host, as `comotion status` says on A."""
        words = ("--json", "--scene", SCENE, "--tls", self.pki / "operator")
        status = self.comotion("a", "status", *words)
        status.wait()
        rows = json.loads(status.output)["components"]
        found = {row["name"]: (row["replica"], row["epoch"]) for row in rows if row["role"] == "service"}
        return {name.removeprefix("fusion-"): replica for name, replica in found.items()}

    def until_active(self, host: str) -> int:
        """Wait until this replica alone is active; its epoch."""
        found: dict[str, tuple[str, int]] = {}

        def is_active() -> bool:
            found.update(self.replicas())
            return [name for name, (role, _) in found.items() if role == "active"] == [host]

        until(lambda: is_active() and len(found) == len(REPLICAS))
        return found[host][1]


def grant(role: str, name: str) -> Grant:
    sources = (name,) if role == "source" else ()
    return Grant(role=role, name=name, common_name="new", scene=SCENE, sources=sources)


@pytest.fixture
def site(tmp_path, start):
    reason = why_not()
    if reason:
        pytest.skip(reason)
    with ExitStack() as stack:
        network = Network(stack)

        def run(host: str, *command: object) -> Process:
            process = start.any(*network.on(host), *command)
            stack.callback(process.close)
            return process

        yield Site(network, tmp_path, run)


def bodies(line: str) -> set[int]:
    """Ids of both bodies if a line of a client shows them at their present places; else nothing."""
    shown = json.loads(line) if line.startswith("{") else {}
    well = bool(shown) and shown["service"]["state"] != "silent" and shown["service"]["age"] < 1.0
    rows = shown.get("hypotheses", [])
    whole = 6 * len(SOURCES)
    present = {row["id"] for row in rows if row["size"] == whole and row["confirmed"] and not row["absent"]}
    live = [source for source in shown.get("sources", []) if source["state"] == "ok"]
    return present if well and len(live) == len(SOURCES) and len(present) == 2 else set()


def seen(site: Site, hosts: Iterable[str] = HOSTS) -> set[int]:
    """The ids that the clients on these hosts show from now on, once they show both bodies."""
    found = []
    for host in hosts:
        client = site.clients[host]
        line = client.wait_line(lambda text: bool(bodies(text)), start=len(client.lines))
        found.append(bodies(line))
    assert all(ids == found[0] for ids in found)
    return found[0]


def until_counted(site: Site, condition: Callable[[dict[str, int]], object]) -> dict[str, int]:
    """The first counters of the active service from now on, as a client shows them, with a condition."""

    def counters(line: str) -> dict[str, int]:
        return json.loads(line)["service"]["counters"] if line.startswith("{") else {}

    client = site.clients["a"]
    found = client.wait_line(
        lambda line: condition(counters(line)) if counters(line) else False, start=len(client.lines)
    )
    return counters(found)


def accounts_for(sent: int, now: dict[str, int]) -> bool:
    """Whether counters tell how many batches never came, but for a few.

    The service counts from the first batch that it sees. When routes change, a batch that others overtake
    counts as lost before it comes, and one may come twice.
    """
    few = FIRST * len(SOURCES) + now["duplicates"] + now["reordered"] + now["late"]
    return abs(sent - now["batches"] - now["lost"]) <= few


def test_a_scene_over_three_hosts_survives_its_network(site):
    before = seen(site)

    # The host of the sources: what they publish meanwhile does not arrive, and is counted.
    site.network.set_link("a", "down")
    time.sleep(CUT_S)
    site.network.set_link("a", "up")
    assert seen(site) == before, "after the sources were cut off"
    until_counted(site, lambda now: now.get("lost", 0) > 0)

    for host in ("a", "b"):
        site.routers[host].kill()
        site.routers[host] = site.router(host)
        site.routers[host].wait_ready()
        assert seen(site) == before, f"after the router of host {host} was killed"

    # The host of the active replica, which goes on: the others hear the standby.
    active, epoch = next((host, epoch) for host, (role, epoch) in site.replicas().items() if role == "active")
    standby = next(host for host in REPLICAS if host != active)
    site.network.set_link(active, "down")
    time.sleep(CUT_S)
    assert seen(site, ("a", standby)) == before, "while the active replica was cut off"
    site.network.set_link(active, "up")
    assert seen(site) == before, "after the active replica was cut off"
    assert site.until_active(standby) > epoch

    for source in site.sources:
        source.popen.terminate()
    said = [source.wait_line(lambda line: line.startswith("sent ")) for source in site.sources]
    sent = sum(int(line.split()[1]) for line in said)
    now = until_counted(site, lambda now: accounts_for(sent, now))
    assert now["lost"] > 0.9 * CUT_S * RATE * len(SOURCES)
