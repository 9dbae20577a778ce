"""Confirmation, absence and return of hypotheses, and the few events that they make."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comotion.config import HypothesesConfig
from comotion.hypotheses.events import Lifecycle
from comotion.hypotheses.identity import IdAllocator
from comotion.hypotheses.registry import Registry
from comotion.partition import Group, Partition
from comotion.trajectories.window import Window

from ..builders import S

STEP = 100_000_000
CONFIG = HypothesesConfig(confirm=0.5, memory=5.0, remembered=2)


class Story:
    """A lifecycle with updates every 0.1 s."""

    def __init__(self, config=CONFIG):
        self.lifecycle, self.now, self.events = Lifecycle(config), 0, []

    def run(self, updates, sizes, origins=None, heirs=None):
        for _ in range(updates):
            self.events += self.lifecycle.advance(self.now, sizes, 3, origins or {}, heirs or {})
            self.now += STEP

    @property
    def heard(self):
        return [(e.kind, e.hypothesis, e.others) for e in self.events]


def test_a_hypothesis_is_confirmed_after_half_a_second_with_enough_members():
    story = Story()
    story.run(5, {1: 5, 2: 2})
    assert not story.lifecycle.confirmed(1)
    story.run(20, {1: 5, 2: 2})
    assert story.lifecycle.confirmed(1)
    assert not story.lifecycle.confirmed(2)
    assert [(e.kind, e.stamp_ns) for e in story.events] == [("born", 5 * STEP)]


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
}


@pytest.mark.parametrize(("parts", "expected"), STORIES.values(), ids=STORIES)
def test_what_lasts_makes_events_and_what_reverts_none(parts, expected):
    story = Story()
    for part in [(10, {1: 5}), *parts]:
        story.run(*part)
    assert story.heard == [("born", 1, []), *expected]


def test_the_longest_absent_is_dropped_where_there_are_too_many():
    story = Story()
    story.run(10, {1: 5})
    story.run(9, {1: 5, 2: 5, 3: 5})
    story.run(2, {2: 5, 3: 5})
    story.run(20, {})
    assert [h for kind, h, _ in story.heard if kind == "absent"] == [1, 2, 3]
    assert [h for kind, h, _ in story.heard if kind == "ended"] == [1]


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
            known = set(story.lifecycle.records)
            story.run(1, {h: n for h, n in kept.items() if h not in gone}, heirs=lost)
            gone |= (known | set(kept)) - set(story.lifecycle.records)
    follows = {None: {"born", "split"}, "ended": set(), "merged": set(), "absent": {"returned", "ended"}}
    last = {}
    for event in story.events:
        for one in event.others if event.kind == "merged" else [event.hypothesis]:
            usual = {"absent", "merged"}
            assert event.kind in follows.get(last.get(one), usual), (last.get(one), event)
            last[one] = event.kind


def test_an_id_that_has_merged_does_not_come_back_with_features_that_were_hidden():
    window, allocator = Window(3, 20 * S, S), IdAllocator()
    registry = Registry(HypothesesConfig(), space="world", allocator=allocator)
    slots, places = window.open(10, 0), np.random.default_rng(0).normal(size=(10, 3))

    def update(k, groups, current):
        stamp_ns = (k + 1) * S // 10
        window.insert(slots[current], stamp_ns, places[current], np.full(len(current), np.nan), None)
        partition = Partition(
            slots[current],
            groups,
            np.ones(len(current), bool),
            np.ones(len(current)),
            places[current],
            [Group()] * 2,
        )
        _, listed, events = registry.update(window, partition, slots[current], stamp_ns)
        return {h.id for h in listed}, [e for e in events if e.kind == "merged"]

    apart, everyone = np.repeat([0, 1], 5), np.arange(10)
    for k in range(30):
        update(k, apart, everyone)
    seen = everyone[2:]
    merged = [event for k in range(30, 80) for event in update(k, np.ones(8, int), seen)[1]]
    assert [event.others for event in merged] == [[1]]
    ids = {one for k in range(80, 90) for one in update(k, np.repeat([0, 1], [2, 8]), everyone)[0]}
    assert ids == {2, 3}
