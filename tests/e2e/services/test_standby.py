"""Two services of one scene: one speaks, and when it is gone the other goes on under the same ids."""

import logging
import os
import signal
import time
from contextlib import ExitStack

import numpy as np
import pytest

from comotion_clients.subscription import Subscription
from comotion_schemas import HypothesisUpdate, Keys, Status, decode_as

from ..conftest import DEADLINE
from ..etcd_cluster import NEEDS_ETCD, EtcdCluster
from ..wire import Wire
from .test_service import is_sorted_out, labels

pytestmark = [pytest.mark.e2e, NEEDS_ETCD]
KEYS = Keys()
NAMES = ("one", "two")
FOLLOWED_NS = 3_000_000_000
FAILOVERS = int(os.environ.get("COMOTION_FAILOVERS", "1"))
"""How often the active service is killed, or cut off; 50 for the figures of docs/fleet.md."""


@pytest.fixture
def replicas(start, endpoint, etcd):
    """Names of two replicas to their processes."""
    found = {name: replica(start, endpoint, etcd.urls[0], name) for name in NAMES}
    for process in found.values():
        process.wait_ready()
    return found


def replica(start, endpoint, url, name):
    words = ("serve", "--standby", "--name", name, "--etcd", url, "--connect", endpoint)
    return start(*words, ready=False)


class Host:
    """A replica behind links of its own, to the router and to etcd."""

    def __init__(self, start, stack, endpoint, url, name):
        self._wires = [stack.enter_context(Wire(target)) for target in (endpoint, url)]
        self.process = replica(start, *(wire.endpoint for wire in self._wires), name)

    def cut(self):
        for wire in self._wires:
            wire.cut()

    def mend(self):
        for wire in self._wires:
            wire.mend()


@pytest.fixture
def hosts(start, endpoint, etcd):
    """Names of two replicas to their hosts."""
    with ExitStack() as stack:
        found = {name: Host(start, stack, endpoint, etcd.urls[0], name) for name in NAMES}
        for host in found.values():
            host.process.wait_ready()
        yield found
        for host in found.values():
            host.process.close()


class Watched:
    """What a client sees: updates in the order of their arrival."""

    def __init__(self, session):
        self.subscription = Subscription(session, HypothesisUpdate)
        self.epochs = []

    def until(self, condition):
        end = time.monotonic() + DEADLINE
        while time.monotonic() < end:
            update = self.subscription.get(DEADLINE)
            self.epochs.append(update.epoch)
            if condition(update):
                return update
        raise AssertionError("what was awaited did not come")


@pytest.fixture
def client(session):
    watched = Watched(session)
    yield watched
    watched.subscription.close()


def asked(session, query="status"):
    replies = [r for r in session.get(KEYS.query(query), timeout=10.0) if r.ok is not None]
    return [decode_as(Status, r.ok.payload.to_bytes()) for r in replies]


def other_than(name):
    return NAMES[1 - NAMES.index(name)]


@pytest.fixture
def follows(session, listen, client):
    """Wait until a replica is a standby and has followed a full window: it knows the scene."""

    def wait(name):
        since = time.time_ns()

        def knows(status):
            return status.replica == "standby" and status.rates and status.stamp_ns > since

        listen(session, KEYS.stream("status", name), "status").until(knows)
        since = time.time_ns()
        client.until(lambda update: update.stamp_ns > since + FOLLOWED_NS)

    return wait


def check_takeover(before, after, client):
    """The same objects under the same ids since the same births, and never an epoch after a higher one."""
    assert labels(after) == labels(before)
    born = [{h.id: h.born_ns for h in update.hypotheses} for update in (before, after)]
    assert born[0] == born[1]
    assert client.epochs == sorted(client.epochs)


def tell(what, gaps, client):
    median, worst, stale = np.median(gaps), max(gaps), client.subscription.counters.stale
    logging.getLogger(__name__).info(
        "s from %s to an update, %d times: median %.2f, worst %.2f; updates of lower epochs dropped: %d",
        what, len(gaps), median, worst, stale,
    )  # fmt: skip


@pytest.mark.timeout(180 + 60 * FAILOVERS)
def test_a_stopped_and_then_a_killed_service_are_followed_by_the_standby_with_the_same_ids(
    start, endpoint, etcd, replicas, session, track, client, follows
):
    track(endpoint)
    before = client.until(is_sorted_out)
    (speaks,) = asked(session)
    assert (speaks.replica, speaks.epoch) == ("active", before.epoch)
    stopped = replicas[speaks.component]
    stopped.signal(signal.SIGSTOP)
    after = client.until(lambda update: update.epoch > before.epoch)
    assert labels(after) == labels(before)
    stopped.signal(signal.SIGCONT)
    stopped.wait_line(lambda line: "is a standby now" in line)
    active, gaps = other_than(speaks.component), []
    for k in range(FAILOVERS):
        if k:
            replicas[other_than(active)] = replica(start, endpoint, etcd.urls[0], other_than(active))
        follows(other_than(active))
        before = client.until(is_sorted_out)
        killed = time.monotonic()
        replicas[active].kill()
        after = client.until(lambda update, old=before.epoch: update.epoch > old)
        gaps.append(time.monotonic() - killed)
        check_takeover(before, after, client)
        (speaks,) = asked(session)
        assert speaks.component == other_than(active)
        active = speaks.component
    tell("kill", gaps, client)


@pytest.mark.timeout(120 + 60 * FAILOVERS)
def test_a_service_that_is_cut_off_is_followed_by_its_standby_and_not_heard_when_it_is_back(
    hosts, endpoint, session, track, client, follows
):
    track(endpoint)
    client.until(is_sorted_out)
    (speaks,) = asked(session)
    active, gaps = speaks.component, []
    for _ in range(FAILOVERS):
        follows(other_than(active))
        before = client.until(is_sorted_out)
        cut = time.monotonic()
        hosts[active].cut()
        after = client.until(lambda update, old=before.epoch: update.epoch > old)
        gaps.append(time.monotonic() - cut)
        check_takeover(before, after, client)
        # It still runs, and believes that it speaks, until it hears of the other.
        said = len(hosts[active].process.lines)
        hosts[active].mend()
        hosts[active].process.wait_line(lambda line: "is a standby now" in line, start=said)
        (speaks,) = asked(session)
        assert speaks.component == other_than(active)
        active = speaks.component
    client.until(lambda update: update.stamp_ns > after.stamp_ns + 1_000_000_000)
    assert client.epochs == sorted(client.epochs)
    tell("cut", gaps, client)


@pytest.mark.long
def test_the_leader_of_etcd_is_killed_then_etcd_is_away_for_30_s(
    start, endpoint, tmp_path, session, track, client
):
    with EtcdCluster(tmp_path, members=3) as cluster:
        urls = ",".join(cluster.urls)
        replicas = [replica(start, endpoint, urls, name) for name in NAMES]
        for process in replicas:
            process.wait_ready()
        track(endpoint)
        before = client.until(is_sorted_out)
        cluster.kill(cluster.leader())
        client.until(lambda update: update.stamp_ns > before.stamp_ns + 5_000_000_000)
        cluster.pause()
        # The active one goes on, and no other speaks.
        after = client.until(lambda update: update.stamp_ns > before.stamp_ns + 35_000_000_000)
        check_takeover(before, after, client)
        cluster.go_on()
        after = client.until(lambda update: update.stamp_ns > before.stamp_ns + 45_000_000_000)
        check_takeover(before, after, client)
        assert len(asked(session)) == 1
        for process in replicas:
            process.close()
