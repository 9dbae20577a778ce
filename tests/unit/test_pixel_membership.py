"""Which group single trajectories of a space in pixels belong to, once there are groups."""

import numpy as np

from comotion.pixels.key_frames import KeyFrames, choose
from comotion.pixels.reassignment import assign_newborns, label_hysteresis, reassign
from comotion.trajectories.window import Window


def drawer_scene(frames=24):
    """Wall on both sides of a drawer that opens in the last frames; 40, 6 and 40 trajectories, truth."""
    rng = np.random.default_rng(0)
    wall = rng.uniform([0, 0], [150, 300], (40, 2))
    corner = rng.uniform([420, 90], [440, 110], (6, 2))
    drawer = rng.uniform([180, 100], [410, 250], (40, 2))
    truth = np.repeat([0, 0, 1], (40, 6, 40))
    positions = np.repeat(np.concatenate([wall, corner, drawer])[None], frames, axis=0)
    # Towards the camera: away from a point beyond its right edge.
    opened = 0.04 * np.maximum(np.arange(frames) - (frames - 5), 0)
    positions += opened[:, None, None] * (positions - [540, 180]) * truth[:, None]
    return positions + rng.normal(0, 0.1, positions.shape), truth


def frames_of(positions, visible=None):
    visible = np.ones(positions.shape[:2], bool) if visible is None else visible
    return KeyFrames(np.where(visible[..., None], positions, 0).astype(np.float32), visible)


def test_a_resting_trajectory_in_a_moving_group_goes_to_the_resting_group():
    positions, truth = drawer_scene()
    mistaken = truth.copy()
    mistaken[40:46] = 1
    np.testing.assert_array_equal(reassign(frames_of(positions), mistaken).labels, truth)
    # Nothing has moved yet: the motion says nothing, whoever belongs where.
    np.testing.assert_array_equal(reassign(frames_of(positions[:18]), mistaken).labels, mistaken)


def test_a_trajectory_that_no_group_explains_keeps_its_label():
    positions, truth = drawer_scene()
    # Half as fast as the drawer: a feature that slides along its edge.
    positions[:, -1] = (positions[:, -1] + positions[0, -1]) / 2
    positions[-5:, 0] += np.arange(5)[:, None] * [3.0, -2.0]
    np.testing.assert_array_equal(reassign(frames_of(positions), truth).labels, truth)


def test_a_trajectory_seen_only_at_rest_keeps_its_label():
    positions, truth = drawer_scene()
    mistaken = truth.copy()
    mistaken[40:46] = 1
    visible = np.ones(positions.shape[:2], bool)
    visible[16:, 40:43] = False
    truth[40:43] = 1
    np.testing.assert_array_equal(reassign(frames_of(positions, visible), mistaken).labels, truth)


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


def test_hysteresis_keeps_labels_while_the_motion_of_the_hypothesis_explains_them():
    own_evidence = np.array([0.9, 0.9, 0.9, 0.9, 0.01, 0.01, 0.01, 0.9])
    labels = np.array([0, 0, 1, 1, 1, 1, 1, 1])
    before = np.array([5, 5, 8, 8, 5, 5, -1, 5])
    explained = np.ones((2, 8), bool)
    explained[0, 5] = False
    # The first with little evidence goes back. The others do not: hypothesis 5 no longer explains the
    # second, the third is new, and the fourth has enough evidence.
    assert label_hysteresis(own_evidence, explained, labels, before).tolist() == [0, 0, 1, 1, 0, 1, 1, 1]


def test_a_resting_trajectory_is_explained_by_every_resting_group():
    positions, truth = drawer_scene()
    positions[:, 80:, 0] += 5.0 * np.arange(24)[:, None]
    labels = np.where(np.arange(86) < 80, truth, 0)
    found = reassign(frames_of(positions[:16]), labels)
    assert found.explained[:, :40].all()
    assert not found.explained[:, 80:].any()


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
