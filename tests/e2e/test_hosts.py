"""Three hosts with a bad network between them: routers meshed with certificates.

Sources on A; two replicas of their scene on B and C; clients on all; etcd on a fourth host. Routers reach
each other by links that delay by 50 ms, jitter and lose datagrams. The host of the sources and that
of the active replica are cut off for 5 s, and routers are killed: output resumes by itself, counters tell
what was lost, ids survive.
"""

import json
import signal
import sys
import time
from contextlib import contextmanager

import pytest

from comotion_tools.system import certificates

from . import tracker
from .etcd_server import NEEDS_ETCD
from .network import BadLink, Wire, free_endpoints
from .tracker import until

pytestmark = [pytest.mark.long, NEEDS_ETCD]
HOSTS = ("a", "b", "c")
REPLICAS = ("b", "c")
SCENE = "cell"
SOURCES = ("left", "right")
CUT_S = 5.0
RATE = 20.0
FIRST = 3
"""Batches that may be published before the service hears the source."""


class Site:
    """The links with certificates, routers, etcd, replicas, sources and clients."""

    def __init__(self, folder, start, etcd):
        self._start, self._pki = start, folder / "pki"
        roles = dict.fromkeys(SOURCES, "source") | {"operator": "viewer"}
        roles |= {f"router-{host}": "router" for host in HOSTS} | {
            f"viewer-{host}": "viewer" for host in HOSTS
        }
        certificates(self._pki, roles | {f"fusion-{host}": "service" for host in REPLICAS}, scene=SCENE)
        endpoints = iter(free_endpoints(2 * len(HOSTS)))
        self._local = {host: next(endpoints).replace("tcp", "tls") for host in HOSTS}
        self._quic = {host: next(endpoints).replace("tcp", "quic") for host in HOSTS}
        self._links = {
            pair: start.enter_context(BadLink(int(self._quic[pair[1]].rpartition(":")[2])))
            for pair in [("b", "a"), ("c", "a"), ("c", "b")]
        }
        self._wires = {host: start.enter_context(Wire(etcd)) for host in REPLICAS}
        self.routers = {host: self.router(host) for host in HOSTS}
        replicas = [self._replica(host) for host in REPLICAS]
        for process in (*self.routers.values(), *replicas):
            process.wait_ready()
        self.sources = [self._source(name) for name in SOURCES]
        self.clients = {host: self._client(host) for host in HOSTS}

    @contextmanager
    def cut_off(self, host):
        """Cut all links of a host, that to etcd too."""
        links = [link for pair, link in self._links.items() if host in pair]
        links += [wire for name, wire in self._wires.items() if name == host]
        for link in links:
            link.cut()
        time.sleep(CUT_S)
        yield
        for link in links:
            link.mend()

    def router(self, host):
        links = [link.port for (near, _), link in self._links.items() if near == host]
        connect = [word for port in links for word in ("--connect", f"quic/127.0.0.1:{port}")]
        listen = ("--listen", self._local[host], "--listen", self._quic[host])
        own = ("--secure", self._pki, "--tls", self._pki / f"router-{host}")
        return self._start("router", *own, *listen, *connect, ready=False)

    def comotion(self, host, certificate, *words):
        at = ("--connect", self._local[host], "--scene", SCENE, "--tls", self._pki / certificate)
        return self._start(*words, *at, ready=False)

    def _replica(self, host):
        name = f"fusion-{host}"
        standby = ("--standby", "--etcd", self._wires[host].endpoint)
        return self.comotion(host, name, "serve", "--no-state", "--name", name, *standby)

    def _source(self, name):
        own = {"name": name, "tls": str(self._pki / name), "seed": len(name), "noise": 0.001}
        at = {"endpoint": self._local["a"], "scene": SCENE, "rate": RATE}
        # The last batch arrives before the presence ends.
        options = json.dumps(own | at | {"stays_s": 1.0})
        return self._start.any(sys.executable, tracker.__file__, options)

    def _client(self, host):
        return self.comotion(host, f"viewer-{host}", "watch", "--json")

    def replicas(self):
        """Role and epoch of each replica, by host, as `comotion status` says on A."""
        status = self.comotion("a", "operator", "status", "--json")
        status.wait()
        rows = json.loads(status.output)["components"]
        found = {row["name"]: (row["replica"], row["epoch"]) for row in rows if row["role"] == "service"}
        return {name.removeprefix("fusion-"): replica for name, replica in found.items()}

    def until_active(self, host):
        """Wait until this replica alone is active; its epoch."""
        found: dict[str, tuple[str, int]] = {}

        def is_active():
            nonlocal found
            found = self.replicas()
            active = [name for name, (role, _) in found.items() if role == "active"]
            return active == [host] and len(found) == len(REPLICAS)

        until(is_active)
        return found[host][1]


@pytest.fixture
def site(tmp_path, start, etcd):
    return Site(tmp_path, start, etcd.urls[0])


def bodies(line):
    """Ids of both bodies if a line of a client shows them at their present places; else nothing."""
    shown = json.loads(line) if line.startswith("{") else {}
    well = bool(shown) and shown["service"]["state"] != "silent" and shown["service"]["age"] < 1.0
    rows = shown.get("hypotheses", [])
    whole = 6 * len(SOURCES)
    present = {row["id"] for row in rows if row["size"] == whole and row["confirmed"] and not row["absent"]}
    live = [source for source in shown.get("sources", []) if source["state"] == "ok"]
    return present if well and len(live) == len(SOURCES) and len(present) == 2 else set()


def seen(site, hosts=HOSTS):
    """The ids that the clients on these hosts show from now on, once they show both bodies."""
    found = []
    for host in hosts:
        client = site.clients[host]
        line = client.wait_line(lambda text: bool(bodies(text)), start=len(client.lines))
        found.append(bodies(line))
    assert all(ids == found[0] for ids in found)
    return found[0]


def until_counted(site, condition):
    """The first counters of the active service from now on, as a client shows them, with a condition."""

    def counters(line):
        return json.loads(line)["service"]["counters"] if line.startswith("{") else {}

    client = site.clients["a"]
    found = client.wait_line(
        lambda line: condition(counters(line)) if counters(line) else False, start=len(client.lines)
    )
    return counters(found)


def accounts_for(sent, now):
    """Whether counters tell how many batches never came, but for a few.

    The service counts from the first batch that it sees. When routes change, a batch that others overtake
    counts as lost before it comes, and one may come twice.
    """
    few = FIRST * len(SOURCES) + now["duplicates"] + now["reordered"] + now["late"]
    return abs(sent - now["batches"] - now["lost"]) <= few


def test_a_scene_over_three_hosts_survives_its_network(site):
    before = seen(site)

    # The host of the sources: what they publish meanwhile does not arrive, and is counted.
    with site.cut_off("a"):
        pass
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
    with site.cut_off(active):
        assert seen(site, ("a", standby)) == before, "while the active replica was cut off"
    assert seen(site) == before, "after the active replica was cut off"
    assert site.until_active(standby) > epoch

    for source in site.sources:
        source.signal(signal.SIGTERM)
    said = [source.wait_line(lambda line: line.startswith("sent ")) for source in site.sources]
    sent = sum(int(line.split()[1]) for line in said)
    now = until_counted(site, lambda now: accounts_for(sent, now))
    assert now["lost"] > 0.9 * CUT_S * RATE * len(SOURCES)
