"""Which slot holds which feature, whatever ids the sources send and in whatever order."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from comotion.trajectories.track_index import TrackIndex
from comotion.trajectories.window import Window

S = 1_000_000_000


def make_index():
    window = Window(2, 10 * S, S)
    return window, TrackIndex(window)


def send(index, ids, session=0):
    """Slots of the ids, opened where need be."""
    ids = np.array(ids, np.uint64)
    slots = index.find(ids, session)
    fresh = slots < 0
    if fresh.any():
        slots[fresh] = index.open(ids[fresh], session)
    index.expect(ids, session, slots)
    return slots.tolist()


def test_a_closed_trajectory_is_not_found_in_the_slot_that_another_has_got():
    _, index = make_index()
    (slot,) = send(index, [1])
    index.close(np.array([slot]))
    assert send(index, [2], session=1) == [slot]
    assert index.find(np.array([1], np.uint64), 0).tolist() == [-1]


def test_what_ends_is_marked_and_unknown_ids_are_ignored():
    window, index = make_index()
    first, second = send(index, [1, 2])
    other = send(index, [1], session=1)[0]
    index.end(np.array([2, 99], np.uint64), 0)
    assert window.ended[[first, second, other]].tolist() == [False, True, False]
    index.end_session(1)
    assert window.ended[[first, second, other]].tolist() == [False, True, True]


@given(st.lists(st.tuples(st.sampled_from("sssc"), st.lists(st.integers(0, 40), unique=True, max_size=25))))
def test_every_feature_keeps_its_slot_until_it_is_closed(steps):
    _, index = make_index()
    expected = {}
    for step, ids in steps:
        if step == "c":
            gone = [expected.pop(i) for i in ids if i in expected]
            index.close(np.array(gone, np.intp))
            continue
        for i, slot in zip(ids, send(index, ids), strict=True):
            assert expected.setdefault(i, slot) == slot
    assert len(set(expected.values())) == len(expected)


def test_an_index_that_was_loaded_finds_the_same_slots():
    window, index = make_index()
    slots = send(index, [5, 3, 8])
    twin = TrackIndex(window)
    twin.load(index.ids[slots], np.array(slots), index.ended())
    assert send(twin, [8, 5, 3]) == [slots[2], slots[0], slots[1]]
