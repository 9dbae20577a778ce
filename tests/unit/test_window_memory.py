"""Memory that trajectories have taken is given back once they are gone; what is left stays as it is."""

import mmap
from pathlib import Path

import numpy as np
import pytest

from comotion.arrays import untouched_zeros
from comotion.trajectories.window import Window

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
