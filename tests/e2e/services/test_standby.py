"""Services of one scene: real etcd elects one, and when it is gone the other goes on under the same ids."""

import signal
import time

import pytest

from comotion.runtime.standby.election import Election
from comotion.runtime.standby.etcd import Etcd
from comotion_clients.subscription import Subscription
from comotion_deploy.demo import free_endpoint
from comotion_schemas import HypothesisUpdate, Keys, Status, decode_as

from ...builders import by_feature as labels
from ...builders import is_sorted_out
from ..etcd_server import NEEDS_ETCD, Wire
from ..waiting import DEADLINE, until

pytestmark = NEEDS_ETCD


def candidate(cluster, name):
    """A service that takes part."""
    return Election(Etcd(cluster.urls), "a", name, name[-1] * 16)


def until_active(election):
    """Wait until it speaks; its epoch."""
    until(lambda: election.epoch is not None)
    return election.epoch


def test_a_suspected_owner_loses_the_scene_at_once_and_learns_it(etcd):
    with candidate(etcd, "s1") as owner:
        before = until_active(owner)
        with candidate(etcd, "s2") as other:
            other.suspect("nobody")
            other.suspect("s1")
            assert until_active(other) > before
            until(lambda: owner.epoch is None)


def test_who_has_just_lost_the_scene_does_not_take_it_back(etcd):
    """A network has split: each side has lost the tokens of the other."""
    with candidate(etcd, "s1") as first:
        until_active(first)
        with candidate(etcd, "s2") as second:
            first.suspect("s2")
            second.suspect("s1")
            epoch = until_active(second)
            until(lambda: first.epoch is None)
            first.suspect("s2")
            with candidate(etcd, "s3") as third:
                until(lambda: third.leader is not None)
                assert third.leader == "s2"
            assert second.epoch == epoch


def test_a_service_that_hears_a_higher_epoch_falls_silent_and_may_be_elected_again(etcd):
    with candidate(etcd, "s1") as only:
        before = until_active(only)
        only.fence(before + 100)
        assert only.epoch is None or only.epoch > before
        assert until_active(only) > before


def test_while_etcd_is_away_the_active_service_goes_on_and_nobody_else_is_elected(etcd):
    with candidate(etcd, "s1") as first:
        until_active(first)
        with candidate(etcd, "s2") as second:
            etcd.pause()
            second.suspect("s1")
            until(lambda: second.error is not None and first.error is not None)
            assert first.epoch is not None
            assert second.epoch is None
            etcd.go_on()
            # Whoever gets the lease: in the end one of them speaks.
            until(lambda: (first.epoch is None) != (second.epoch is None))


def test_a_member_that_does_not_answer_is_passed_over(etcd):
    urls = [free_endpoint().replace("tcp/", "http://"), *etcd.urls]
    with Election(Etcd(urls), "a", "s1", "1" * 16) as only:
        until_active(only)
        client = Etcd(urls)
        client.put("still", b"here")
        assert client.read("still").value == b"here"


@pytest.mark.parametrize("url", ["etcd:2379", "http://", "http://a:b", "ftp://a:1"])
def test_a_wrong_url_is_refused(url):
    with pytest.raises(ValueError, match="url of etcd"):
        Etcd([url])


KEYS = Keys()
NAMES = ("one", "two")
FOLLOWED_NS = 3_000_000_000


class Host:
    """A replica behind links of its own, to the router and to etcd."""

    def __init__(self, start, endpoint, url, name):
        self._wires = [start.enter_context(Wire(target)) for target in (endpoint, url)]
        router, etcd = (wire.endpoint for wire in self._wires)
        words = ("serve", "--standby", "--name", name, "--etcd", etcd, "--connect", router)
        self.process = start(*words, ready=False)

    def cut(self):
        for wire in self._wires:
            wire.cut()

    def mend(self):
        for wire in self._wires:
            wire.mend()


@pytest.fixture
def hosts(start, endpoint, etcd):
    """Names of two replicas to their hosts."""
    hosts = {name: Host(start, endpoint, etcd.urls[0], name) for name in NAMES}
    for host in hosts.values():
        host.process.wait_ready()
    return hosts


class Watched:
    """What a client sees: updates in the order of their arrival."""

    def __init__(self, session):
        self.subscription = Subscription(session, HypothesisUpdate)
        self.epochs = []

    def until(self, condition):
        def is_so():
            self.last = self.subscription.get(DEADLINE)
            self.epochs.append(self.last.epoch)
            return condition(self.last)

        until(is_so)
        return self.last


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


def test_a_service_that_is_cut_off_stopped_or_killed_is_followed_by_the_standby_with_the_same_ids(
    hosts, endpoint, session, track, client, follows
):
    track(endpoint)
    client.until(is_sorted_out)
    (speaks,) = asked(session)
    other, cut_off = other_than(speaks.component), hosts[speaks.component]
    follows(other)
    before = client.until(is_sorted_out)
    assert (speaks.replica, speaks.epoch) == ("active", before.epoch)
    cut_off.cut()
    after = client.until(lambda update: update.epoch > before.epoch)
    check_takeover(before, after, client)
    # It still runs, and believes that it speaks, until it hears of the other.
    printed = len(cut_off.process.lines)
    cut_off.mend()
    cut_off.process.wait_line(lambda line: "is a standby now" in line, start=printed)
    assert [status.component for status in asked(session)] == [other]
    follows(speaks.component)

    before = client.until(is_sorted_out)
    stopped = hosts[other].process
    printed = len(stopped.lines)
    stopped.signal(signal.SIGSTOP)
    after = client.until(lambda update: update.epoch > before.epoch)
    assert labels(after) == labels(before)
    stopped.signal(signal.SIGCONT)
    stopped.wait_line(lambda line: "is a standby now" in line, start=printed)
    follows(other)

    before = client.until(is_sorted_out)
    cut_off.process.kill()
    after = client.until(lambda update: update.epoch > before.epoch)
    check_takeover(before, after, client)
    assert [status.component for status in asked(session)] == [other]
