"""Events between partitions, as the protocol defines them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from comotion.hypotheses.events import Membership, changes


def membership(labels):
    """Of {track: label}."""
    return Membership(np.array(list(labels), np.int64), np.array(list(labels.values()), np.int64))


def told(before, after):
    found = changes(7, membership(before), membership(after))
    assert all(event.stamp_ns == 7 for event in found)
    return [(event.kind, event.hypothesis, event.others) for event in found]


def test_nothing_happens():
    assert told({1: 4, 2: 4}, {1: 4, 2: 4}) == []
    assert told({}, {}) == []


def test_members_that_change_sides_are_no_event():
    assert told({1: 4, 2: 4, 3: 5}, {1: 4, 2: 5, 3: 5}) == []


def test_born_of_newborns():
    assert told({1: 4}, {1: 4, 2: 5, 3: 5}) == [("born", 5, [])]


def test_born_of_the_undetermined():
    assert told({1: -1, 2: -1}, {1: 5, 2: 5}) == [("born", 5, [])]


def test_split():
    assert told({1: 4, 2: 4, 3: 4}, {1: 4, 2: 4, 3: 6}) == [("split", 6, [4])]


def test_split_names_the_one_most_members_left():
    before = {1: 4, 2: 4, 3: 5, 4: 5, 5: 5, 6: 4}
    assert told(before, {1: 4, 2: 6, 3: 6, 4: 6, 5: 5, 6: 4}) == [("split", 6, [5])]


def test_few_defectors_among_newborns_make_no_split():
    assert told({1: 4, 2: 4}, {1: 4, 2: 6, 3: 6, 4: 6}) == [("born", 6, [])]


def test_merged_and_not_ended():
    assert told({1: 4, 2: 4, 3: 5}, {1: 4, 2: 4, 3: 4}) == [("merged", 4, [5])]


def test_several_merge_into_one():
    assert told({1: 4, 2: 5, 3: 6}, {1: 4, 2: 4, 3: 4}) == [("merged", 4, [5, 6])]


def test_ended_when_the_members_are_gone_or_mostly_gone():
    assert told({1: 4, 2: 5}, {1: 4}) == [("ended", 5, [])]
    assert told({1: 4, 2: 5, 3: 5, 4: 5}, {1: 4, 2: 4}) == [("ended", 5, [])]
    assert told({1: 4, 2: 5}, {1: 4, 2: -1}) == [("ended", 5, [])]


def test_order_is_beginnings_mergers_ends():
    before = {1: 4, 2: 5, 3: 9, 4: 8}
    after = {1: 4, 2: 4, 6: 11, 7: 10}
    assert [kind for kind, _, _ in told(before, after)] == ["born", "born", "merged", "ended", "ended"]


memberships = st.dictionaries(st.integers(0, 12), st.integers(-1, 5), max_size=12)


@given(before=memberships, after=memberships)
def test_events_account_for_every_hypothesis_that_comes_or_goes(before, after):
    was, now = set(before.values()) - {-1}, set(after.values()) - {-1}
    events = told(before, after)
    begun = [h for kind, h, _ in events if kind in ("born", "split")]
    gone = [h for kind, h, _ in events if kind == "ended"]
    gone += [h for kind, _, others in events if kind == "merged" for h in others]
    assert sorted(begun) == sorted(now - was)
    assert sorted(gone) == sorted(was - now)
    for kind, hypothesis, others in events:
        if kind == "split":
            assert others[0] in was
        if kind == "merged":
            assert hypothesis in was & now
