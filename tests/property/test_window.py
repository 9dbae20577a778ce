"""The window against a plain list of observations, under random life and death, and its memory."""

import mmap
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comotion.arrays import untouched_zeros
from comotion.trajectories.window import Window

SPAN = 100

operations = st.lists(
    st.one_of(
        st.tuples(st.just("insert"), st.integers(0, 5), st.integers(-30, 40)),
        st.tuples(st.just("evict"), st.just(0), st.integers(0, 30)),
        st.tuples(st.just("close"), st.integers(0, 5), st.just(0)),
    ),
    max_size=120,
)


def literal_speeds(track):
    """Backward differences over everything ever observed; the first takes the second's."""
    ordered = sorted(track)
    speeds = [0.0]
    for (t0, x0), (t1, x1) in pairwise(ordered):
        speeds.append(float(np.linalg.norm(np.subtract(x1, x0))) / ((t1 - t0) * 1e-9))
    if len(speeds) > 1:
        speeds[0] = speeds[1]
    return {t: s for (t, _), s in zip(ordered, speeds, strict=True)}


@settings(max_examples=150)
@given(operations, st.integers(0, 2**32 - 1))
def test_window_holds_exactly_what_lies_inside_it(steps, seed):
    rng = np.random.default_rng(seed)
    window = Window(2, SPAN, 10)
    slot_of, ever, held, now = {}, {}, {}, 100
    for kind, track, step in steps:
        if kind == "insert":
            now = max(now, now + step)
            stamp = now + min(step, 0)
            if track not in slot_of:
                slot_of[track] = window.open(1, 0)
                ever[track], held[track] = [], {}
            position = rng.normal(size=2)
            known = stamp in held[track]
            if held[track] and stamp < min(held[track]):
                continue
            if not held[track] and ever[track]:
                continue
            stored = window.insert(slot_of[track], stamp, position[None], np.array([np.nan]), None)
            assert bool(stored[0]) is not known
            if not known:
                ever[track].append((stamp, tuple(position)))
                held[track][stamp] = position
        elif kind == "evict":
            before = now - SPAN + step
            slots, counts = window.evictable(before)
            window.evict(slots, counts)
            held = {k: {t: x for t, x in v.items() if t >= before} for k, v in held.items()}
        elif track in slot_of:
            window.close(slot_of.pop(track))
            del ever[track], held[track]
    for track, slot in slot_of.items():
        times, positions, speed = (
            window.held(column, int(slot[0])) for column in (window.times, window.positions, window.speed)
        )
        assert times.tolist() == sorted(held[track])
        speeds = literal_speeds(ever[track])
        for time, position, fast in zip(times, positions, speed, strict=True):
            assert np.array_equal(position, held[track][time])
            assert np.isclose(fast, speeds[time], rtol=1e-12)


def test_state_round_trip_keeps_every_view():
    rng = np.random.default_rng(0)
    window = Window(3, SPAN, 10)
    slots = window.open(3, 7)
    for stamp in range(5):
        turns = np.full((3, 4), np.nan) if stamp else None
        window.insert(slots, stamp, rng.normal(size=(3, 3)), np.full(3, 0.1), turns)
    window.evict(*window.evictable(2))
    other = Window(3, SPAN, 10)
    twin = other.load(window.state())
    for mine, theirs in zip(window.slots(), twin, strict=True):
        for name in ("times", "positions", "speed", "sigma", "quaternions"):
            left = window.held(getattr(window, name), int(mine))
            right = other.held(getattr(other, name), int(theirs))
            assert np.array_equal(left, right, equal_nan=True)
    assert other.key[twin].tolist() == window.key[window.slots()].tolist()
    assert not set(other.open(1, 0).tolist()) & set(twin.tolist())


SECOND = 10**9


def fill(window: Window, slots: np.ndarray, instants: int, first: int = 0) -> None:
    for k in range(first, first + instants):
        positions = np.full((len(slots), 3), float(k)) + slots[:, None]
        window.insert(slots, k * SECOND // 100, positions, np.full(len(slots), np.nan), None)


def held(window: Window, slots: np.ndarray) -> list[np.ndarray]:
    return [window.held(window.positions, int(one)).copy() for one in slots]


def size(window: Window) -> int:
    return window.times.size


@pytest.mark.parametrize("late", [0, 30])
def test_rows_that_one_trajectory_needed_are_given_back(late) -> None:
    window = Window(3, 10 * SECOND, SECOND)
    slots, long = window.open(10, 1), window.open(1, 2)
    fill(window, slots, 50)
    before = size(window)
    fill(window, long, 5000)
    assert size(window) > 50 * before
    # What is left begins somewhere in its rows.
    window.evict(slots, np.full(10, late))
    kept = held(window, slots)
    window.close(long)
    assert size(window) <= 4 * before
    for one, was in zip(held(window, slots), kept, strict=True):
        np.testing.assert_array_equal(one, was)
    fill(window, slots, 200, first=50)
    np.testing.assert_array_equal(window.counts(slots), np.full(10, 250 - late))


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no system that says so")
def test_rows_that_nobody_writes_to_take_no_memory() -> None:
    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1]) * mmap.PAGESIZE

    size = 64 << 20
    column, before = untouched_zeros((size // 8, 1), np.int64), resident()
    column[:: (1 << 21) // 8] = 1
    assert resident() - before < size // 8
    assert column.sum() == size >> 21
