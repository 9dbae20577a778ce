"""Which group single trajectories of a space in pixels belong to, once there are groups."""

import numpy as np

from comotion.pixels.key_frames import choose
from comotion.pixels.newborns import assign_newborns
from comotion.trajectories.window import Window


def test_the_living_and_half_as_many_of_the_dead_are_compared():
    seen = np.array([9, 3, 4, 8, 7, 5] + 6 * [6])
    dead = np.repeat([True, False], 6)
    # Of the dead who was seen longest; nobody who was hardly seen at all.
    assert choose(seen, dead, 14, few=6).tolist() == [0, 3, 4, *range(6, 12)]
    # Of a few there is no choice.
    assert choose(seen[:8], dead[:8], 14, few=6).tolist() == [0, 3, 4, 5, 6, 7]
    assert choose(np.full(20, 24), np.zeros(20, bool), 14, few=6).tolist() == list(range(14))


def test_newborns_go_with_neighbours_that_move_as_they_do():
    rest = np.stack([np.full(6, 40.0), np.arange(6) * 8.0], axis=1)
    drawer = np.stack([np.full(6, 0.0), np.arange(6) * 8.0], axis=1)
    # One rests just before the drawer, one moves with it close to what rests.
    newborn = np.array([[10.0, 20.0], [30.0, 20.0]])
    start = np.concatenate([rest, drawer, newborn])
    moves = np.repeat([0, 1, 0, 1], (6, 6, 1, 1))
    window = Window(2, 10**10, 10**9)
    slots = window.open(14, 0)
    for k in range(10):
        here = slots if k >= 6 else slots[:12]
        x = start + np.outer(moves, [0.0, 3.0]) * k
        window.insert(here, (1 + k) * 10**8, x[: len(here)], np.full(len(here), np.nan), None)
    labels = np.repeat([7, 8], 6)
    nobody = np.full(2, -1)
    found, _ = assign_newborns(window, slots[12:], slots[:12], labels, nobody)
    assert found.tolist() == [7, 8]


def test_a_near_neighbour_counts_more_than_far_ones():
    start = np.array(
        [[0.0, 0.0], [90.0, 0.0], [91.0, 9.0], [92.0, 4.0], [10.0, 0.0], [12.0, 0.0], [5.0, 0.0]]
    )
    window = Window(2, 10**10, 10**9)
    slots = window.open(7, 0)
    for k in range(3):
        window.insert(slots, (1 + k) * 10**8, start, np.full(7, np.nan), None)
    labels = np.array([7, 8, 8, 8, 7, 8])
    found, share = assign_newborns(window, slots[6:], slots[:6], labels, np.array([-1]))
    assert found.tolist() == [7]
    assert 0.5 < share[0] < 1
    # What it was is worth one vote of five.
    assert assign_newborns(window, slots[6:], slots[:6], labels, np.array([8]))[0].tolist() == [7]
