"""Grouping in pixel space: small scenes, epipolar geometry, life between updates."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.pixels.consensus import consensus
from comotion.pixels.grouping import group, held_apart
from comotion.pixels.key_frames import KeyFrames
from comotion.pixels.merging import merged
from comotion_clients.metrics import misclassification

from .. import builders
from ..builders import labels_of, play, restored


def frames_of(positions, visible=None, noise=0.0):
    visible = np.ones(positions.shape[:2], bool) if visible is None else visible
    variance = np.full(positions.shape[1], noise**2, np.float32)
    return KeyFrames(np.where(visible[..., None], positions, 0).astype(np.float32), visible, variance)


def grouped(frames):
    """Groups of trajectories that had no hypothesis before."""
    return group(frames, np.full(len(frames.variance), -1))


def affine_scene(rng, sizes, frames=24, noise=0.1):
    """Bodies that each undergo a smooth affine motion of their own."""
    parts = []
    for size in sizes:
        x = rng.uniform(-120, 120, (size, 2)) + rng.uniform(200, 400, 2)
        rate, turn = rng.uniform(-3, 3, 2), rng.uniform(-0.01, 0.01)
        steps = []
        for t in range(frames):
            c, s = np.cos(turn * t), np.sin(turn * t)
            steps.append((x - x.mean(0)) @ np.array([[c, s], [-s, c]]) + x.mean(0) + rate * t)
        parts.append(np.array(steps))
    truth = np.repeat(np.arange(len(sizes)), sizes)
    positions = np.concatenate(parts, axis=1)
    return positions + rng.normal(0, noise, positions.shape), truth


@pytest.mark.parametrize("sizes", [(60,), (70, 40), (80, 40, 30)])
def test_bodies_are_told_apart_without_their_number(sizes):
    rng = np.random.default_rng(5)
    positions, truth = affine_scene(rng, sizes)
    visible = rng.random(positions.shape[:2]) > 0.15
    labels, confidence, _ = grouped(frames_of(positions, visible))
    assert misclassification(labels, truth) <= 0.02
    assert (confidence >= 0).all()
    assert (confidence <= 1).all()


def test_few_trajectories_of_two_bodies_are_not_one_affine_motion():
    rng = np.random.default_rng(13)
    x = rng.uniform(0, 100, (1, 35, 2))
    x[:, 20:] += [250, 0]
    moving = (np.arange(35) >= 20)[None, :, None]
    positions = x + 2.0 * np.arange(16)[:, None, None] * moving + rng.normal(0, 0.1, (16, 35, 2))
    labels = grouped(frames_of(positions))[0]
    np.testing.assert_array_equal(labels == labels[0], np.arange(35) < 20)


def test_noise_that_is_known_does_not_join_bodies():
    positions, truth = affine_scene(np.random.default_rng(0), (60, 50), noise=1.0)
    assert misclassification(grouped(frames_of(positions, noise=1.0))[0], truth) <= 0.02
    # Taken for motion, it widens the kernel.
    assert grouped(frames_of(positions))[0].max() == 0


def image(seq, now, positions, ids=None):
    ids = np.arange(len(positions)) if ids is None else ids
    ids = ids.astype(np.uint64)
    return builders.batch("cam", seq, now, positions, space="cam/pixels", unit="px", ids=ids)


class Camera:
    """Two bodies at 15 Hz; trajectory i is born at `born[i]` and lost at `lost[i]`, in frames."""

    def __init__(self, born=(0,) * 70, lost=(40,) * 70):
        self.positions, self.truth = affine_scene(np.random.default_rng(9), (40, 30), 40, 0.1)
        self.born, self.lost = np.array(born), np.array(lost)

    def play(self, fusion, start, stop):
        return play(fusion, range(start, stop), self.seen, rate=15)

    def seen(self, k, now):
        alive = (self.born <= k) & (k < self.lost)
        return image(k, now, self.positions[k, alive], np.flatnonzero(alive))


def pixel_fusion():
    return Fusion(FusionConfig(method="comotion"), scene="default", session="0" * 16)


def test_identities_outlive_births_and_deaths():
    rng = np.random.default_rng(10)
    born, lost = np.zeros(70, int), np.full(70, 40)
    renewed = rng.permutation(70)[:24]
    born[renewed[:12]], lost[renewed[12:]] = 20, 20
    camera = Camera(born, lost)
    updates = camera.play(pixel_fusion(), 0, 40)
    middle, final = updates[18], updates[-1]
    for update in (middle, final):
        assert misclassification(update.track_hypothesis, camera.truth[update.track_id.astype(int)]) == 0
    assert {h.id for h in middle.hypotheses} == {h.id for h in final.hypotheses}
    assert len(final.hypotheses) == 2
    kinds = {event.kind for update in updates for event in update.events}
    assert "born" in kinds
    assert "ended" not in kinds


def test_newborns_start_from_their_neighbours():
    born = np.zeros(70, int)
    born[[3, 50]] = 38
    final = Camera(born).play(pixel_fusion(), 0, 40)[-1]
    of = labels_of(final)
    assert {of[3], of[50]} <= {h.id for h in final.hypotheses}
    # In the scene the bodies overlap in the image, so only being near something is promised.
    assert all(final.track_confidence[np.isin(final.track_id, [3, 50])] <= 0.5)


def test_a_hypothesis_says_how_it_moves():
    rng = np.random.default_rng(11)
    x = rng.uniform(100, 300, (40, 2))

    def seen(k, now):
        moved = np.concatenate([x + np.array([3.0 * k, 0.0]), x + 150.0])
        return image(k, now, moved + rng.normal(0, 0.05, moved.shape))

    by_state = {h.state: h for h in play(pixel_fusion(), range(30), seen, rate=15)[-1].hypotheses}
    assert set(by_state) == {"moving", "static"}
    assert by_state["moving"].twist.linear == pytest.approx([45.0, 0.0], abs=0.5)
    assert by_state["moving"].twist.angular == pytest.approx(0.0, abs=0.02)
    assert by_state["static"].noise < 0.2


def test_what_rests_in_the_image_of_a_moving_camera_is_undetermined():
    rng = np.random.default_rng(3)
    # The camera drives along z between walls; of a car ahead at its own speed nobody knows that it moves.
    wall = np.stack([rng.choice([-3.0, 3.0], 90), rng.uniform(-2, 1.5, 90), rng.uniform(8, 16, 90)], axis=1)
    car = rng.uniform([280, 220], [360, 280], (30, 2))

    def seen(k, now):
        ahead = wall - [0.0, 0.0, 0.15 * k]
        moved = np.concatenate([320 + 500 * ahead[:, :2] / ahead[:, 2:], car])
        return image(k, now, moved + rng.normal(0, 0.1, moved.shape))

    update = play(pixel_fusion(), range(30), seen, rate=15)[-1]
    of, states = labels_of(update), {h.id: h.state for h in update.hypotheses}
    assert {states[of[k]] for k in range(90, 120)} == {"undetermined"}
    assert {states[of[k]] for k in range(90)} == {"moving"}


def test_a_car_at_the_speed_of_the_camera_is_undetermined_in_whatever_group_it_is():
    rng = np.random.default_rng(4)
    # Far houses hardly move in the image either, and share the group of the walls.
    wall = np.stack([rng.choice([-5.0, 5.0], 160), rng.uniform(-3, 2, 160), rng.uniform(8, 60, 160)], axis=1)
    far = np.stack([rng.uniform(-40, 40, 60), rng.uniform(-15, 5, 60), rng.uniform(90, 150, 60)], axis=1)
    car = rng.uniform([290, 250], [350, 290], (25, 2))

    def seen(k, now):
        ahead = np.concatenate([wall, far]) - [0.0, 0.0, 0.25 * k]
        before = np.flatnonzero(np.append(ahead[:, 2] > 1, np.ones(25, bool)))
        moved = np.concatenate([320 + 500 * ahead[:, :2] / ahead[:, 2:], car])[before]
        return image(k, now, moved + rng.normal(0, 0.1, moved.shape), before)

    update = play(pixel_fusion(), range(30), seen, rate=15)[-1]
    of, states = labels_of(update), {h.id: h.state for h in update.hypotheses}
    assert not any(states.get(of[k]) in {"moving", "static"} for k in range(220, 245))
    assert sum(states.get(of.get(k)) == "moving" for k in range(220)) > 150


def test_gross_errors_do_not_join_or_part_bodies():
    camera, rng = Camera(), np.random.default_rng(2)
    wild, angle = rng.random((40, 70)) < 0.03, rng.uniform(0, 2 * np.pi, (40, 70))
    off = wild * rng.uniform(10, 60, wild.shape) * [np.cos(angle), np.sin(angle)]
    camera.positions += np.moveaxis(off, 0, 2)
    final = camera.play(pixel_fusion(), 0, 40)[-1]
    assert misclassification(final.track_hypothesis, camera.truth[final.track_id.astype(int)]) <= 0.03


def test_a_restart_keeps_hypotheses():
    camera = Camera()
    fusion = pixel_fusion()
    before = camera.play(fusion, 0, 30)[-1]
    again = restored(fusion)
    after, unbroken = camera.play(again, 30, 40)[-1], camera.play(fusion, 30, 40)[-1]
    assert {h.id for h in after.hypotheses} == {h.id for h in before.hypotheses}
    np.testing.assert_array_equal(after.track_hypothesis, unbroken.track_hypothesis)
    assert [h.born_ns for h in after.hypotheses] == [h.born_ns for h in unbroken.hypotheses]


FRAMES, NEAR, FAR, OTHER = 24, np.arange(30), np.arange(30, 60), np.arange(60, 90)
FOCAL = 500.0


def scene(noise, hidden=0.0, drive=(0.05, 0.01, 0.03)):
    """Images of a near and a far part of one scene, and of a body that moves, before a driving camera."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-1.5, -1, 3], [1.5, 1, 5], (90, 3))
    points[FAR, 2] += 3
    positions = np.empty((FRAMES, 90, 2))
    for t in range(FRAMES):
        seen = points - t * np.array(drive)
        seen[OTHER] += t * np.array([-0.03, 0.05, 0.0])
        positions[t] = FOCAL * seen[:, :2] / seen[:, 2:]
    positions += rng.normal(0, noise, positions.shape)
    return frames_of(positions, rng.random((FRAMES, 90)) >= hidden, noise)


@pytest.mark.parametrize(("noise", "hidden"), [(0.1, 0.0), (0.5, 0.0), (0.1, 0.3)])
def test_parts_of_one_body_rank_epipolar_geometries_alike(noise, hidden):
    groups = [NEAR, FAR, OTHER[:15], OTHER[15:], np.zeros(0, int)]
    agreement = consensus(scene(noise, hidden), groups, np.random.default_rng(0))
    assert min(agreement[0, 1], agreement[2, 3]) > 0.2
    assert agreement[:2, 2:].max() < 0.1
    np.testing.assert_array_equal(agreement, agreement.T)
    # Of a group that is never seen nothing is known.
    assert not agreement[4].any()


@pytest.mark.parametrize(("previous", "count"), [([-1, -1], 1), ([3, 3], 1), ([3, -1], 1), ([3, 4], 2)])
def test_what_was_apart_stays_apart_on_little_evidence(previous, count):
    alike, near = np.full((2, 20, 20), [[[0.5]], [[1.0]]], np.float32)
    agreed = held_apart(np.full((2, 2), 0.2), np.split(np.arange(20), 2), np.repeat(previous, 10))
    assert merged(alike, near, np.repeat([0, 1], 10), agreed).max() + 1 == count
