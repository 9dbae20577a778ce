"""The compiled interpolation against a plain one, wherever the stamp lies."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.trajectories.interpolation import states_at
from comotion.trajectories.kernels import newest_at, newest_from, segment_at
from comotion.trajectories.window import Window

from ..reference.interpolation import segment

times = st.lists(st.integers(0, 60), max_size=20, unique=True).map(sorted)
stamps = st.lists(st.integers(-5, 80), min_size=1, max_size=12).map(sorted)


@settings(max_examples=100)
@given(
    times=times,
    stamps=stamps,
    max_gap=st.integers(1, 20),
    max_ahead=st.integers(0, 10),
    before=st.integers(0, 3),
)
def test_a_segment_is_the_one_that_holds_the_stamp(times, stamps, max_gap, max_ahead, before):
    column = np.array([0] * before + times + [0] * 3, np.int64)
    stop = before + len(times)
    walk = before - 1
    for stamp in stamps:
        walk = newest_from(column, walk, stop, stamp)
        assert walk == newest_at(column, before, stop, stamp)
        left, right, share = segment_at(column, before, stop, walk, stamp, max_gap, max_ahead)
        want = segment(times, stamp, max_gap, max_ahead)
        assert (left, right) == (tuple(k + before for k in want[:2]) if want[0] >= 0 else (-1, -1))
        assert share == want[2]


@settings(max_examples=50)
@given(series=st.lists(times.filter(len), min_size=1, max_size=4), stamps=stamps, gap=st.integers(1, 20))
def test_states_are_those_of_the_segments(series, stamps, gap):
    window = Window(2, 10**9, gap)
    slots = window.open(len(series), 0)
    for slot, times in zip(slots, series, strict=True):
        for t in times:
            window.insert(slot[None], t, np.array([[t * t, -t]], float), np.array([np.nan]), None)
    states = states_at(window, slots, np.array(stamps))
    for n, times in enumerate(series):
        for t, stamp in enumerate(stamps):
            left, right, share = segment(times, stamp, gap, 0)
            assert states.held[t, n] == (left >= 0)
            assert states.observed[t, n] == (stamp in times)
            if left >= 0:
                x = [(1 - share) * k * k + share * m * m for k, m in [(times[left], times[right])]]
                np.testing.assert_allclose(states.position[t, n], [*x, -stamp], rtol=1e-12, atol=1e-12)
