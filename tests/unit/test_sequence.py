"""The one counter of sequence numbers: loss, order, repetition, and how much it remembers."""

from hypothesis import given
from hypothesis import strategies as st

from comotion_schemas.sequence import MAX_GAPS, MAX_JUMP, MAX_SESSIONS, SequenceCounter, Sighting

A, B = "a" * 16, "b" * 16


def sight(numbers, counter=None):
    counter = counter or SequenceCounter()
    return [counter.sight("cam", A, seq) for seq in numbers]


def test_a_late_joiner_has_lost_nothing_and_every_skipped_number_is_a_loss():
    assert sight([7, 8, 11]) == [Sighting(0, "newest"), Sighting(0, "newest"), Sighting(2, "newest")]


def test_publishers_and_sessions_are_counted_apart():
    counter = SequenceCounter()
    streams = [("cam", A), ("cam", B), ("arm", A)]
    for seq in (0, 2):
        assert [counter.sight(*stream, seq).lost for stream in streams] == [seq // 2] * 3


def test_a_reader_from_the_start_has_lost_what_came_before_the_first():
    counter = SequenceCounter(from_zero=True)
    assert [s.lost for s in sight([3, 4, 1, 6], counter)] == [3, 0, -1, 1]


def test_a_jump_that_no_loss_explains_is_counted_apart_and_mutes_nothing():
    sightings = sight([0, 1, 2**64 - 1, 2, 3, 2**64 - 1, 4])
    assert [s.order for s in sightings] == [*["newest"] * 5, "repeated", "newest"]
    assert sum(s.lost for s in sightings) == 0
    assert sight([0, MAX_JUMP])[1].lost == MAX_JUMP - 1


def test_a_restored_counter_goes_on():
    counter, twin = SequenceCounter(from_zero=True), SequenceCounter(from_zero=True)
    sight([2, 7, 5], counter)
    twin.load(counter.state())
    assert sight([9, 6, 5, 0], twin) == sight([9, 6, 5, 0], counter)
    assert twin.newest("cam", A) == 9


@given(st.lists(st.integers(0, 50), min_size=1))
def test_every_number_is_new_exactly_once_and_what_is_missing_was_lost(numbers):
    sightings = sight(numbers)
    fresh = [seq for seq, s in zip(numbers, sightings, strict=True) if s.order != "repeated"]
    assert sorted(fresh) == sorted(set(numbers))
    never = set(range(numbers[0], max(numbers) + 1)) - set(numbers)
    assert sum(s.lost for s in sightings) == len(never)


def test_a_flood_of_sessions_leaves_those_seen_last():
    counter = SequenceCounter()
    sight([0], counter)
    counter.sight("idle", A, 0)
    for k in range(MAX_SESSIONS - 1):
        counter.sight("flood", f"{k:016x}", 0)
        sight([0], counter)
    assert sight([0], counter) == [Sighting(0, "repeated")]
    assert counter.sight("idle", A, 0) == Sighting(0, "newest")


def test_more_gaps_than_are_remembered_count_their_oldest_numbers_as_repeated():
    counter = SequenceCounter()
    sight(range(0, 2 * MAX_GAPS + 4, 2), counter)
    assert sight([1, 3, 5], counter)[0] == Sighting(0, "repeated")
    assert sight([2 * MAX_GAPS - 1], counter) == [Sighting(-1, "overtaken")]
