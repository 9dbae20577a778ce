"""Two services of one scene: one speaks, and when it is gone the other goes on under the same ids."""

import logging
import os
import signal
import time

import pytest

from comotion_clients.subscription import Subscription
from comotion_schemas import HypothesisUpdate, Keys, Status, decode_as

from .conftest import DEADLINE
from .etcd_cluster import NEEDS_ETCD, EtcdCluster
from .test_service import is_sorted_out, labels

pytestmark = [pytest.mark.e2e, NEEDS_ETCD]
KEYS = Keys()
FAILOVERS = int(os.environ.get("COMOTION_FAILOVERS", "2"))
"""How often the active service is killed; 50 for the table of docs/standby.md."""


@pytest.fixture
def etcd(tmp_path):
    with EtcdCluster(tmp_path) as cluster:
        yield cluster


@pytest.fixture
def replicas(start, endpoint, etcd):
    """Names of two replicas to their processes."""
    return {name: replica(start, endpoint, etcd, name) for name in ("one", "two")}


def replica(start, endpoint, etcd, name):
    return start("serve", "--standby", "--name", name, "--etcd", etcd.urls[0], "--connect", endpoint)


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


def test_a_killed_service_is_followed_by_its_standby_with_the_same_ids(
    start, endpoint, etcd, replicas, session, track, client, listen
):
    track(endpoint)
    first = client.until(is_sorted_out)
    (speaks,) = asked(session)
    assert (speaks.replica, speaks.epoch) == ("active", first.epoch)
    standby = next(name for name in replicas if name != speaks.component)
    listen(session, KEYS.stream("status", standby), "status").until(lambda s: s.replica == "standby")
    gaps = []
    for _ in range(FAILOVERS):
        before = client.until(is_sorted_out)
        killed = time.monotonic()
        replicas[speaks.component].kill()
        after = client.until(lambda update, old=before.epoch: update.epoch > old)
        gaps.append(time.monotonic() - killed)
        assert labels(after) == labels(before)
        births = {h.id: h.born_ns for h in before.hypotheses}
        assert {h.id: h.born_ns for h in after.hypotheses} == births
        (now,) = asked(session)
        assert now.component != speaks.component
        replicas[speaks.component] = replica(start, endpoint, etcd, speaks.component)
        # It has followed the active one for a while: the next kill finds a standby that knows the scene.
        following = listen(session, KEYS.stream("status", speaks.component), "status")
        following.until(lambda s: s.replica == "standby" and s.counters.get("tracks", 0) > 0)
        since = time.time_ns()
        client.until(lambda update, since=since: update.stamp_ns > since + 3_000_000_000)
        speaks = now
    assert client.epochs == sorted(client.epochs)
    logging.getLogger(__name__).info("s from kill to update: %s", sorted(round(gap, 3) for gap in gaps))


def test_a_service_that_was_stopped_is_not_heard_when_it_goes_on(endpoint, replicas, session, track, client):
    track(endpoint)
    before = client.until(is_sorted_out)
    (speaks,) = asked(session)
    stopped = replicas[speaks.component]
    stopped.signal(signal.SIGSTOP)
    after = client.until(lambda update: update.epoch > before.epoch)
    assert labels(after) == labels(before)
    stopped.signal(signal.SIGCONT)
    stopped.wait_line(lambda line: "is a standby now" in line)
    client.until(lambda update: update.stamp_ns > after.stamp_ns + 1_000_000_000)
    assert client.epochs == sorted(client.epochs)
    assert len(asked(session)) == 1
