"""Election of the service that speaks for a scene, by real etcd servers."""

import pytest

from comotion.runtime.standby import Election, Etcd

from .etcd_cluster import NEEDS_ETCD, EtcdCluster
from .tracker import until

pytestmark = NEEDS_ETCD


class Candidate:
    """A service that takes part; `until` waits for a state of its election."""

    def __init__(self, cluster, name):
        self.epochs = []
        self.election = Election(lambda: Etcd(cluster.urls), "a", name, name[-1] * 16, changed=self._note)

    def _note(self):
        self.epochs.append(self.election.epoch)

    def until(self, condition):
        until(lambda: condition(self.election.epoch))
        return self.election.epoch

    def __enter__(self):
        self.election.__enter__()
        return self

    def __exit__(self, *exception):
        self.election.__exit__(None, None, None)


def speaks(epoch):
    return epoch is not None


def silent(epoch):
    return epoch is None


def test_one_speaks_and_when_it_resigns_the_other_does_with_a_higher_epoch(etcd):
    with Candidate(etcd, "s1") as first:
        before = first.until(speaks)
        with Candidate(etcd, "s2") as second:
            until(lambda: second.election.leader is not None)
            assert second.election.leader == "s1"
            assert second.election.epoch is None
            first.election.__exit__(None, None, None)
            assert second.until(speaks) > before


def test_a_suspected_owner_loses_the_scene_at_once_and_learns_it(etcd):
    with Candidate(etcd, "s1") as owner:
        before = owner.until(speaks)
        with Candidate(etcd, "s2") as other:
            other.election.suspect("nobody")
            other.election.suspect("s1")
            assert other.until(speaks) > before
            owner.until(silent)


def test_who_has_just_lost_the_scene_does_not_take_it_back(etcd):
    """A network has split: each side has lost the tokens of the other."""
    with Candidate(etcd, "s1") as first:
        first.until(speaks)
        with Candidate(etcd, "s2") as second:
            first.election.suspect("s2")
            second.election.suspect("s1")
            epoch = second.until(speaks)
            first.until(silent)
            first.election.suspect("s2")
            with Candidate(etcd, "s3") as third:
                until(lambda: third.election.leader is not None)
                assert third.election.leader == "s2"
            assert second.election.epoch == epoch


def test_a_service_that_hears_a_higher_epoch_falls_silent_and_may_be_elected_again(etcd):
    with Candidate(etcd, "s1") as only:
        before = only.until(speaks)
        only.election.fence(before + 100)
        assert only.epochs[-1] is None or only.epochs[-1] > before
        assert only.until(speaks) > before


def test_while_etcd_is_away_the_active_service_goes_on_and_nobody_else_is_elected(etcd):
    with Candidate(etcd, "s1") as first:
        first.until(speaks)
        with Candidate(etcd, "s2") as second:
            etcd.pause()
            second.election.suspect("s1")
            until(lambda: second.election.error is not None and first.election.error is not None)
            assert first.election.epoch is not None
            assert second.election.epoch is None
            etcd.go_on()
            # Whoever gets the lease: in the end one of them speaks.
            until(lambda: (first.election.epoch is None) != (second.election.epoch is None))


def test_three_members_lose_one_and_nothing_happens(tmp_path):
    with EtcdCluster(tmp_path, members=3) as cluster, Candidate(cluster, "s1") as only:
        before = only.until(speaks)
        cluster.kill(0)
        cluster.wait()  # it may have led: the other two elect first
        client = Etcd(cluster.urls)
        client.put("still", b"here")
        assert client.read("still").value == b"here"
        assert client.urls == tuple(cluster.urls)
        assert only.until(speaks) >= before


def test_keys_leases_and_transactions(etcd):
    client = Etcd(["http://127.0.0.1:1", *etcd.urls])
    first = client.create("k", b"one")
    assert client.create("k", b"two") is None
    assert client.replace("k", first + 1, b"two") is None
    assert client.replace("k", first, b"two") > first
    client.put("kk", b"")
    assert {key: entry.value for key, entry in client.read_all("k").items()} == {"k": b"two", "kk": b""}
    lease = client.grant(5)
    client.put("leased", b"", lease)
    assert client.read("leased").lease == lease
    before = client.revision
    assert client.renew(lease)
    assert client.revision == before
    Etcd(etcd.urls).put("kkk", b"")
    assert client.renew(lease)
    assert client.revision == before + 1
    client.revoke(lease)
    client.revoke(lease)
    assert not client.renew(lease)
    assert client.read("leased") is None
    assert client.delete("k")
    assert not client.delete("k")


@pytest.mark.parametrize("url", ["etcd:2379", "http://", "http://a:b", "ftp://a:1"])
def test_a_wrong_url_is_refused(url):
    with pytest.raises(ValueError, match="url of etcd"):
        Etcd([url])
