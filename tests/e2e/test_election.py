"""Election of the service that speaks for a scene, by real etcd servers."""

import pytest

from comotion.runtime.standby import Election, Etcd

from .etcd_server import NEEDS_ETCD
from .network import free_endpoints
from .tracker import until

pytestmark = NEEDS_ETCD


def candidate(cluster, name):
    """A service that takes part."""
    return Election(lambda: Etcd(cluster.urls), "a", name, name[-1] * 16)


def until_active(election):
    """Wait until it speaks; its epoch."""
    until(lambda: election.epoch is not None)
    return election.epoch


def test_one_speaks_and_when_it_resigns_the_other_does_with_a_higher_epoch(etcd):
    with candidate(etcd, "s1") as first:
        before = until_active(first)
        with candidate(etcd, "s2") as second:
            until(lambda: second.leader is not None)
            assert second.leader == "s1"
            assert second.epoch is None
            first.__exit__(None, None, None)
            assert until_active(second) > before


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
    urls = [free_endpoints(1)[0].replace("tcp/", "http://"), *etcd.urls]
    with Election(lambda: Etcd(urls), "a", "s1", "1" * 16) as only:
        until_active(only)
        client = Etcd(urls)
        client.put("still", b"here")
        assert client.read("still").value == b"here"


@pytest.mark.parametrize("url", ["etcd:2379", "http://", "http://a:b", "ftp://a:1"])
def test_a_wrong_url_is_refused(url):
    with pytest.raises(ValueError, match="url of etcd"):
        Etcd([url])
