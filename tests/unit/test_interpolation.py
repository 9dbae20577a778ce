"""Where trajectories were: the search among their times, and how far they have come."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.arrays import aligned_zeros
from comotion.trajectories.interpolation import locate, recent_steps
from comotion.trajectories.window import Window

NEVER = np.iinfo(np.int64).min


def filled(series, dropped=0):
    """A window of one slot per list of ascending times; x is the time, y its negative."""
    window = Window(2, 10**9, 10**9)
    slots = window.open(len(series), 0)
    for slot, times in zip(slots, series, strict=True):
        for t in times:
            window.insert(np.array([slot]), t, np.array([[t, -t]], float), np.array([np.nan]), None)
    counts = np.minimum(dropped, window.counts(slots))
    window.evict(slots, counts)
    return window, slots


times = st.lists(st.integers(0, 400), min_size=1, max_size=150, unique=True).map(sorted)


@settings(deadline=None)
@given(series=times, stamp=st.integers(-2, 402), dropped=st.integers(0, 40))
def test_the_newest_observation_at_a_time_is_found_wherever_it_is(series, stamp, dropped):
    window, slots = filled([series], dropped)
    left = series[dropped:]
    want = min(dropped, len(series)) + np.searchsorted(left, stamp, side="right") - 1
    assert locate(window, slots, stamp).tolist() == [want]


@settings(deadline=None)
@given(series=times, before=st.integers(-2, 402))
def test_evictable_is_what_is_older(series, before):
    window, slots = filled([series])
    found, counts = window.evictable(before)
    older = sum(t < before for t in series)
    assert dict(zip(found.tolist(), counts.tolist(), strict=True)) == ({slots[0]: older} if older else {})


def test_a_recent_step_begins_at_the_newest_observation_that_is_old_enough_or_at_the_first():
    window, slots = filled([[0, 100, 170, 200], [150, 200], [200]])
    step, took = recent_steps(window, slots, 60)
    assert took.tolist() == [100, 50, 0]
    assert step.tolist() == [[100, -100], [50, -50], [0, 0]]


def test_aligned_arrays_begin_at_a_cache_line():
    for shape in ((3,), (5, 7), (0, 4)):
        array = aligned_zeros(shape, np.float32)
        assert array.shape == shape
        assert array.flags.c_contiguous
        assert not array.any()
        assert array.ctypes.data % 64 == 0 or not array.size
