"""The life of hypotheses: confirmation, absence and return, their few events, and whom a group continues."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from comotion.config import HypothesesConfig
from comotion.hypotheses.identity import IdAllocator, balanced, recognised
from comotion.hypotheses.records import Current, Record
from comotion.hypotheses.registry import Registry
from comotion.matching import continued, largest_first
from comotion.partition import NO_HYPOTHESIS, Group, Partition, PoseReference
from comotion.trajectories.window import Window
from comotion_schemas import Twist

from ..builders import S, hypothesis

STEP = 100_000_000
CONFIG = HypothesesConfig(confirm=0.5, memory=5.0)


class Story:
    """A registry with updates every 0.1 s."""

    def __init__(self, config=CONFIG):
        self.registry, self.now, self.events = Registry(config, "", IdAllocator()), 0, []

    def run(self, updates, sizes, origins=None, heirs=None):
        for _ in range(updates):
            self.events += self.registry.advance(self.now, sizes, 3, origins or {}, heirs or {})
            self.now += STEP

    @property
    def heard(self):
        return [(e.kind, e.hypothesis, e.others) for e in self.events]


# After a second of hypothesis 1 with five members: what `run` gets, and the events after its birth.
STORIES = {
    "a split that reverts": ([(4, {1: 5, 2: 3}, {2: 1}), (20, {1: 8})], []),
    "a split that lasts": ([(9, {1: 5, 2: 3}, {2: 1})], [("split", 2, [1])]),
    "a merger that reverts": (
        [(9, {1: 5, 2: 3}), (4, {1: 8}, {}, {2: 1}), (20, {1: 5, 2: 3})],
        [("born", 2, [])],
    ),
    "mergers that last": (
        [(9, {1: 5, 2: 3, 3: 4}), (20, {1: 12}, {}, {2: 1, 3: 1})],
        [("born", 2, []), ("born", 3, []), ("merged", 1, [2, 3])],
    ),
    "absent, returned and ended": (
        [(10, {}), (10, {1: 4}), (70, {})],
        [("absent", 1, []), ("returned", 1, []), ("absent", 1, []), ("ended", 1, [])],
    ),
    "too few members": ([(20, {1: 5, 2: 2})], []),
    "too many that are absent": (
        [(9, {1: 5, 2: 5, 3: 5}), (2, {2: 5, 3: 5}), (20, {})],
        [("born", 2, []), ("born", 3, []), *(("absent", one, []) for one in (1, 2, 3)), ("ended", 1, [])],
    ),
}


@pytest.mark.parametrize(("parts", "expected"), STORIES.values(), ids=STORIES)
def test_what_lasts_makes_events_and_what_reverts_none(parts, expected, monkeypatch):
    monkeypatch.setattr("comotion.hypotheses.registry._REMEMBERED", 2)
    story = Story()
    for part in [(10, {1: 5}), *parts]:
        story.run(*part)
    assert story.events[0].stamp_ns == 5 * STEP
    assert story.heard == [("born", 1, []), *expected]


updates = st.lists(
    st.tuples(
        st.integers(1, 12),
        st.dictionaries(st.integers(1, 5), st.integers(1, 5), max_size=5),
        st.dictionaries(st.integers(1, 5), st.integers(1, 5), max_size=3),
    ),
    max_size=12,
)


@given(updates=updates)
def test_each_event_follows_from_the_one_before(updates):
    """By hypothesis: a beginning, absences and returns in turn, and an end; the dead make no events.

    Ids of hypotheses that are gone are not used again, as the allocator never gives them out twice.
    """
    story, gone = Story(), set()
    for repeat, sizes, heirs in updates:
        kept = {h: n for h, n in sizes.items() if h not in gone}
        lost = {h: heir for h, heir in heirs.items() if h not in kept and heir in kept}
        for _ in range(repeat):
            known = set(story.registry.records)
            story.run(1, {h: n for h, n in kept.items() if h not in gone}, heirs=lost)
            gone |= (known | set(kept)) - set(story.registry.records)
    follows = {None: {"born", "split"}, "ended": set(), "merged": set(), "absent": {"returned", "ended"}}
    last = {}
    for event in story.events:
        for one in event.others if event.kind == "merged" else [event.hypothesis]:
            usual = {"absent", "merged"}
            assert event.kind in follows.get(last.get(one), usual), (last.get(one), event)
            last[one] = event.kind


def updates_of(count):
    """What follows features into groups: gives the ids shown, and the merged events."""
    window, allocator = Window(3, 20 * S, S), IdAllocator()
    registry = Registry(HypothesesConfig(), space="world", allocator=allocator)
    slots, places = window.open(count, 0), np.random.default_rng(0).normal(size=(count, 3))

    def update(k, groups, current, gone=0):
        """`groups` of the first features, which are `gone`, and of the current ones."""
        stamp_ns, grouped = (k + 1) * S // 10, np.append(np.arange(gone), current)
        window.insert(slots[current], stamp_ns, places[current], np.full(len(current), np.nan), None)
        deciding, sure = np.ones(len(grouped), bool), np.ones(len(current))
        partition = Partition(slots[grouped], groups, deciding, sure, places[current], [Group()] * 2)
        _, listed, events = registry.update(window, partition, slots[current], stamp_ns)
        return {h.id: h.size for h in listed}, [e for e in events if e.kind == "merged"]

    return update


APART, EVERYONE = np.repeat([0, 1], 5), np.arange(10)


def test_an_id_that_has_merged_does_not_come_back_with_features_that_were_hidden():
    update, seen = updates_of(10), EVERYONE[2:]
    for k in range(30):
        update(k, APART, EVERYONE)
    merged = [event for k in range(30, 80) for event in update(k, np.ones(8, int), seen)[1]]
    assert [event.others for event in merged] == [[1]]
    ids = {one for k in range(80, 90) for one in update(k, np.repeat([0, 1], [2, 8]), EVERYONE)[0]}
    assert ids == {2, 3}


def test_an_id_that_vanished_before_it_was_confirmed_is_not_given_again():
    update = updates_of(10)
    assert update(0, APART, EVERYONE)[0] == {1: 5, 2: 5}
    assert update(1, APART[:5], EVERYONE[:5])[0] == {1: 5}
    assert update(2, APART, EVERYONE)[0] == {1: 5, 3: 5}


def test_who_is_gone_has_no_say_in_whose_the_id_is():
    update = updates_of(20)
    for k in range(30):
        assert update(k, np.zeros(20, int), np.arange(20))[0] == {1: 20}
    # Six that have gone are grouped with the smaller part of those that are seen.
    assert update(31, np.repeat([1, 0, 1], [6, 8, 6]), np.arange(6, 20), gone=6)[0] == {1: 8, 2: 6}


CORNERS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])


def described(one, velocity=(0.0, 0.0, 0.0), state="moving"):
    twist = Twist(linear=list(velocity), angular=[0.0, 0.0, 0.0])
    return hypothesis(one, size=8, state=state, twist=twist)


def current(places, count=8):
    """Of each hypothesis by id and centre; its features are 100 id, 100 id + 1 and on."""
    keys = np.concatenate([100 * one + np.arange(count) for one in places])
    positions = np.concatenate([CORNERS[:count] + centre for centre in places.values()])
    labels = np.repeat(list(places), count)
    return Current(keys, np.arange(len(keys)), labels, positions, np.zeros(len(keys), int))


def appeared(seconds, centre, scale=1.0):
    return round(seconds * S), CORNERS * scale + centre


def memory(*bodies):
    """Of (id, centre, velocity, static) at time 0; the features of hypothesis i are 100 i to 100 i + 7."""
    records = {}
    for one, centre, velocity, static in bodies:
        records[one] = Record(PoseReference.new(0), description=described(one, velocity), static=static)
        records[one].see(0, one, current({one: centre}), posed=False)
    return records


STILL = (0.0, 0.0, 0.0)
HERE = (1, (0, 0, 0), STILL, False)
SLOW = (1, (0, 0, 0), (0.3, 0, 0), False)
RECOGNISED = {
    "at its place": (
        [HERE, (2, (1, 0, 0), STILL, False)],
        {7: appeared(1, (1.02, 0, 0)), 8: appeared(1, (0, 0.03, 0))},
        {7: 2, 8: 1},
    ),
    "not elsewhere": ([HERE], {7: appeared(1, (1, 0, 0))}, {}),
    "not with another extent": ([HERE], {7: appeared(1, (0, 0, 0), scale=10)}, {}),
    "not far off soon after": ([SLOW], {7: appeared(0.1, (-0.8, 0, 0))}, {}),
    "farther off after a while": ([SLOW], {7: appeared(3, (-0.8, 0, 0))}, {7: 1}),
    "not between two equal places": (
        [(1, (0, 0, 0.1), STILL, False), (2, (0, 0, -0.1), STILL, False)],
        {7: appeared(1, (0, 0, 0))},
        {},
    ),
    "the static body wherever it is": (
        [(1, (0, 0, 0), STILL, True), (2, (5, 0, 0), STILL, False)],
        {7: None},
        {7: 1},
    ),
}


@pytest.mark.parametrize(("known", "new", "expected"), RECOGNISED.values(), ids=RECOGNISED)
def test_a_body_is_recognised(known, new, expected):
    assert recognised(memory(*known), new, 1.0) == expected


def test_a_body_is_expected_about_the_place_where_it_has_been():
    def passed_by(to):
        records = {one: Record(PoseReference.new(0), description=described(one)) for one in (1, 2)}
        for second in range(11):
            places = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.0, 0.0)} if second < 10 else {1: to, 2: to}
            for one, record in records.items():
                record.see(second * S, one, current(places), posed=False)
        return records

    new = {7: appeared(13, (0.9, 0, 0)), 8: appeared(13, (0.1, 0, 0))}
    assert recognised(passed_by((0.5, 0.0, 0.0)), new, 1.0) == {7: 2, 8: 1}


def test_what_two_sources_see_outweighs_as_many_features_of_a_third():
    before, groups = np.zeros(25, np.int64), np.repeat([0, 1], [12, 13])
    sources = np.repeat([0, 1, 2], [6, 6, 13])
    for whose, expected in ((sources, {0: 0}), (0 * sources, {1: 0})):
        assert continued(before, groups, 2, largest_first, balanced(before, whose)) == expected


def struck(shared: np.ndarray) -> list[tuple[int, int]]:
    """The rule of the thesis word by word."""
    left, pairs = shared.copy(), []
    while left.any():
        k, m = np.unravel_index(int(left.argmax()), left.shape)
        pairs.append((int(k), int(m)))
        left[k], left[:, m] = 0, 0
    return pairs


@given(st.lists(st.tuples(st.integers(-1, 5), st.integers(0, 5)), max_size=30))
@example([(5, 0)] * 3 + [(7, 0)] * 2 + [(7, 1)])  # 5 overlaps most with 0, which leaves 7 with 1
def test_clusters_continue_hypotheses_by_the_rule_of_the_thesis(rows):
    before = np.array([b for b, _ in rows], np.int64)
    # Cluster numbers without gaps.
    clusters = np.unique([c for _, c in rows], return_inverse=True)[1].astype(np.intp)
    old = before != NO_HYPOTHESIS
    known, row = np.unique(before[old], return_inverse=True)
    shared = np.zeros((len(known), clusters.max(initial=-1) + 1), int)
    np.add.at(shared, (row, clusters[old]), 1)
    expected = {c: int(known[h]) for h, c in struck(shared)}
    assert continued(before, clusters, shared.shape[1], largest_first) == expected
