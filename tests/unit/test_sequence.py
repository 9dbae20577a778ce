"""The one counter of sequence numbers: loss, order, repetition, and how much it remembers."""

from collections import Counter, defaultdict

from hypothesis import given
from hypothesis import strategies as st

from comotion.saving import plain, restored
from comotion_schemas.sequence import MAX_GAPS, MAX_JUMP, MAX_SESSIONS, SequenceCounter, Sighting

A, B = "a" * 16, "b" * 16


def sight(numbers, counter=None):
    counter = counter or SequenceCounter()
    return [counter.sight("cam", A, seq) for seq in numbers]


streams = st.sampled_from([("cam", A), ("cam", B), ("arm", A)])


@given(st.lists(st.tuples(streams, st.integers(0, 12))), st.booleans(), st.integers(0, 20))
def test_every_number_of_a_session_is_new_once_and_what_is_missing_since_the_first_was_lost(
    numbers, from_zero, restart
):
    """The counter is saved and restored on the way; from zero on, what came before the first is lost too."""
    counter, first, seen, lost = SequenceCounter(from_zero=from_zero), {}, defaultdict(set), Counter()
    for k, (stream, seq) in enumerate(numbers):
        if k == restart:
            counter = restored(SequenceCounter, plain(counter))
        known = seen[stream]
        expected = "newest" if seq > max(known, default=-1) else "repeated" if seq in known else "overtaken"
        found = counter.sight(*stream, seq)
        known.add(seq)
        lost[stream] += found.lost
        begin = 0 if from_zero else first.setdefault(stream, seq)
        assert found.order == expected
        assert lost[stream] == len(set(range(begin, max(known))) - known)
        assert counter.newest(*stream) == max(known)


def test_a_jump_that_no_loss_explains_begins_anew_and_mutes_nothing():
    sightings = sight([0, 1, 2**64 - 1, 2, 3, 2**64 - 1, 4])
    assert [s.order for s in sightings] == ["newest"] * 7
    assert sum(s.lost for s in sightings) == 0
    assert sight([0, MAX_JUMP])[1].lost == MAX_JUMP - 1


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
