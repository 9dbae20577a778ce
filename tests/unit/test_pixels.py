"""Grouping in pixel space: parity with literal references, small scenes, life between updates."""

import itertools
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.config import PixelsConfig
from comotion.pixels import merging
from comotion.pixels.affine import explain
from comotion.pixels.epipolar import EpipolarTest
from comotion.pixels.grouping import group
from comotion.pixels.key_frames import KeyFrames, evenly_spaced, frame_pairs
from comotion.pixels.linkage import Superclusters, link
from comotion.pixels.merging import BoundaryContrast, merge
from comotion.pixels.neighbour_sampling import NeighbourDistance
from comotion.pixels.similarity import Similarity, subspace
from comotion.pixels.wide_baseline import WideBaselineTest, wide_pairs
from comotion_clients.metrics import misclassification
from comotion_schemas import UNDETERMINED

from .. import builders
from ..builders import MS, T0, labels_of


def frames_of(positions, visible=None):
    visible = np.ones(positions.shape[:2], bool) if visible is None else visible
    return KeyFrames(np.where(visible[..., None], positions, 0).astype(np.float32), visible)


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


def perspective_body(rng, size, velocity, turn, frames=24):
    """A rigid body two to eight metres away, seen by a pinhole camera of 500 px."""
    x = rng.uniform([-2, -1, 2], [2, 1, 8], (size, 3))
    seen = []
    for t in range(frames):
        c, s = np.cos(turn * t), np.sin(turn * t)
        y = x @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + np.asarray(velocity) * t
        seen.append(500 * y[:, :2] / y[:, 2:] + [320, 240])
    return np.array(seen)


def test_linkage_ends_on_a_matrix_that_is_not_symmetric():
    turns = np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]], np.float32)
    found = link(Similarity(turns, np.ones((3, 3), np.float32), np.zeros(3, np.float32)), 0.5)
    assert len(found.of) == 3


def test_similarity_is_symmetric_to_the_last_bit():
    rng = np.random.default_rng(12)
    positions, _ = affine_scene(rng, (50, 47))
    visible = rng.random(positions.shape[:2]) > 0.3
    found = group(frames_of(positions, visible), PixelsConfig()).similarity
    np.testing.assert_array_equal(found.value, found.value.T)
    np.testing.assert_array_equal(found.evidence, found.evidence.T)


def test_local_motions_equal_a_literal_fit():
    rng = np.random.default_rng(1)
    positions, _ = affine_scene(rng, (9, 7), frames=6, noise=1.0)
    visible = rng.random((6, 16)) > 0.2
    pairs = frame_pairs(frames_of(positions, visible), (1, 3))
    members = np.array([[0, 1, 2, 3, 4], [5, 6, 9, 10, 11]])
    found = explain(pairs, [members])
    total, used = np.zeros((2, 16)), np.zeros((2, len(pairs.seen)))
    for q in range(len(pairs.seen)):
        for h in range(2):
            inside = members[h][pairs.seen[q, members[h]] > 0]
            if len(inside) < 4:
                continue
            used[h, q] = 1
            x, u = pairs.start[q].T.astype(float), pairs.displacement[q].T.astype(float)
            dx, du = x[inside] - x[inside].mean(0), u[inside] - u[inside].mean(0)
            a = np.linalg.solve(dx.T @ dx + 25.0 * len(inside) * np.eye(2), dx.T @ du)
            square = ((u - u[inside].mean(0) - (x - x[inside].mean(0)) @ a) ** 2).sum(1)
            total[h] += np.minimum(square, 400.0) * pairs.seen[q]
    np.testing.assert_array_equal(found.used, used)
    np.testing.assert_allclose(found.total, total, rtol=2e-3, atol=2e-3)


def test_neighbour_distance_counts_common_frames_only():
    rng = np.random.default_rng(2)
    positions, _ = affine_scene(rng, (6,), frames=8, noise=2.0)
    visible = rng.random((8, 6)) > 0.3
    found = NeighbourDistance(frames_of(positions, visible), 10.0).to_all(np.array([0, 3]))
    for row, i in enumerate((0, 3)):
        for j in range(6):
            both = visible[:, i] & visible[:, j]
            if both.sum() < 2:
                assert np.isinf(found[row, j])
                continue
            place = ((positions[both, i] - positions[both, j]) ** 2).sum(1).mean()
            steps = both[1:] & both[:-1]
            move = np.diff(positions[:, i], axis=0) - np.diff(positions[:, j], axis=0)
            moved = (move[steps] ** 2).sum(1).mean() if steps.any() else 0.0
            expected = (np.sqrt(place) + 10 * np.sqrt(moved)) / np.sqrt(both.sum() / 8)
            assert found[row, j] == pytest.approx(expected, rel=1e-3, abs=0.05)


def test_completion_recovers_a_low_rank_scene():
    rng = np.random.default_rng(3)
    positions, _ = affine_scene(rng, (30,), noise=0.0)
    visible = rng.random((24, 30)) > 0.2
    whole = subspace(frames_of(positions), 4, 4, 60)
    gappy = subspace(frames_of(positions, visible), 4, 4, 300)
    # The same subspace: projectors agree, whatever the basis. Float32 leaves about 1e-3.
    np.testing.assert_allclose(whole[:3].T @ whole[:3], gappy[:3].T @ gappy[:3], atol=0.02)


def test_evenly_spaced_keeps_both_ends():
    assert evenly_spaced(5, 24).tolist() == [0, 1, 2, 3, 4]
    chosen = evenly_spaced(100, 24)
    assert (chosen[0], chosen[-1], len(np.unique(chosen))) == (0, 99, 24)


def test_epipolar_test_tells_one_body_in_perspective_from_two():
    rng = np.random.default_rng(4)
    one = perspective_body(rng, 80, (0.03, 0.0, 0.05), 0.004)
    other = perspective_body(rng, 40, (-0.06, 0.05, 0.0), -0.01)
    positions = np.concatenate([one, other], axis=1)
    positions += rng.normal(0, 0.1, positions.shape)
    test = EpipolarTest(frames_of(positions))
    near, far, second = np.arange(40), np.arange(40, 80), np.arange(80, 120)
    assert test.compare(near, far).log_ratio < np.log(1.5)
    assert test.compare(near, second).log_ratio > np.log(3)
    assert not test.compare(near, second).one_rests
    assert test.compare(near[:8], far) is None


def test_a_group_that_moves_past_a_resting_one_is_another_body():
    rng = np.random.default_rng(14)
    positions = np.repeat(rng.uniform(0, 400, (1, 60, 2)), 24, axis=0) + rng.normal(0, 0.1, (24, 60, 2))
    # At the very end only, as when a drawer begins to move.
    positions[:, 40:] += 3.0 * np.maximum(np.arange(24) - 20, 0)[:, None, None]
    found = EpipolarTest(frames_of(positions)).compare(np.arange(40), np.arange(40, 60))
    # One epipolar geometry fits both: only the camera's rest tells them apart.
    assert found.log_ratio < np.log(1.5)
    assert found.one_rests


def wide_baseline_test(*bodies, noise=0.1):
    positions = np.concatenate(bodies, axis=1)
    positions = positions + np.random.default_rng(0).normal(0, noise, positions.shape)
    ends = np.cumsum([0, *(body.shape[1] for body in bodies)])
    groups = [np.arange(a, b) for a, b in itertools.pairwise(ends)]
    return WideBaselineTest(frames_of(positions), groups, 0.02), groups


def test_parallax_within_a_body_explains_that_between_its_parts():
    rng = np.random.default_rng(4)
    body = perspective_body(rng, 80, (0.03, 0.0, 0.05), 0.004)
    nearest = np.argsort(np.linalg.norm(body[-1] - body[0], axis=1))
    test, (slow, fast) = wide_baseline_test(body[:, nearest[:40]], body[:, nearest[40:]])
    assert test.one_body(slow, fast)
    assert not test.two_bodies(slow, fast)
    assert not test.one_body(slow[:8], fast)


def test_two_bodies_that_only_translate_share_a_geometry_but_no_parallax():
    rng, t = np.random.default_rng(5), np.arange(24)[:, None, None]
    test, (left, right) = wide_baseline_test(
        rng.uniform(0, 200, (1, 40, 2)) + t * [1.0, 0.2], rng.uniform(200, 400, (1, 40, 2)) + t * [-1.0, 0.7]
    )
    assert not test.one_body(left, right)
    assert not test.two_bodies(left, right)


def test_a_few_features_of_another_body_contradict_over_a_wide_baseline():
    rng = np.random.default_rng(6)
    background = perspective_body(rng, 40, (0.03, 0.0, 0.02), 0.004)
    body = perspective_body(rng, 8, (-0.02, 0.02, 0.0), -0.004)
    test, (scene, few) = wide_baseline_test(background, body)
    assert test.two_bodies(scene, few)
    # In a short window there is no wide baseline.
    assert wide_pairs(10) == []


def test_boundary_contrast_compares_similarity_across_with_that_within():
    x = np.stack([np.arange(20.0), np.zeros(20)], axis=1)
    left, right = np.arange(10), np.arange(10, 20)
    frames = frames_of(np.repeat(x[None], 6, axis=0))
    value = np.full((20, 20), 0.5, np.float32)
    value[:10, 10:] = value[10:, :10] = 0.125
    contrast = BoundaryContrast(frames, value).between(left, right)
    assert contrast.drop == pytest.approx(np.log(0.126 / 0.501), abs=1e-4)
    # The nearest five of the other side are 3 px farther away than the nearest one.
    assert contrast.distance == pytest.approx(5.5 + 2, abs=1e-4)
    apart = frames_of(frames.positions, (np.arange(6) < 3)[:, None] == (np.arange(20) < 10))
    assert BoundaryContrast(apart, value).between(left, right) is None


def test_previous_hypotheses_shift_the_merge_threshold():
    rng = np.random.default_rng(15)
    positions = rng.uniform(0, 400, (1, 80, 2)) + np.cumsum(rng.normal(0, 2, (24, 1, 2)), axis=0)
    frames = frames_of(positions + rng.normal(0, 0.1, (24, 80, 2)))
    superclusters = Superclusters(
        np.repeat([0, 1], 40), np.full((2, 2), 1600 * merging.SIMILARITY), np.full((2, 2), 1600.0)
    )
    test = EpipolarTest(frames)
    left, right = np.arange(40), np.arange(40, 80)
    # Without the test that would join them whatever they were before.
    wide = SimpleNamespace(one_body=lambda *_: False, two_bodies=lambda *_: False)
    distance = BoundaryContrast(frames, np.ones((80, 80), np.float32)).between(left, right).distance
    threshold = merging._LEAST_EVIDENCE + merging._EPIPOLAR_WEIGHT * test.compare(left, right).log_ratio

    def groups(surplus, before):
        value = np.ones((80, 80), np.float32)
        drop = threshold - merging._DISTANCE_WEIGHT * np.log1p(distance) + surplus
        value[:40, 40:] = value[40:, :40] = np.exp(drop)
        boundary = BoundaryContrast(frames, value)
        return len(set(merge(superclusters, boundary, test, wide, 5, before).tolist()))

    apart, together = np.repeat([7, 8], 40), np.full(80, 7)
    assert [groups(0.5 * merging._HELD_APART, before) for before in (None, together, apart)] == [1, 1, 2]
    assert [groups(-0.5 * merging._HELD_TOGETHER, before) for before in (None, together, apart)] == [2, 1, 2]


@pytest.mark.parametrize("sizes", [(60,), (70, 40), (80, 40, 30)])
def test_bodies_are_told_apart_without_their_number(sizes):
    rng = np.random.default_rng(5)
    positions, truth = affine_scene(rng, sizes)
    visible = rng.random(positions.shape[:2]) > 0.15
    found = group(frames_of(positions, visible), PixelsConfig())
    assert misclassification(found.labels, truth) <= 0.02
    assert (found.confidence >= 0).all()
    assert (found.confidence <= 1).all()


def test_few_trajectories_of_two_bodies_are_not_one_affine_motion():
    rng = np.random.default_rng(13)
    x = rng.uniform(0, 100, (1, 35, 2))
    x[:, 20:] += [250, 0]
    moving = (np.arange(35) >= 20)[None, :, None]
    positions = x + 2.0 * np.arange(16)[:, None, None] * moving + rng.normal(0, 0.1, (16, 35, 2))
    found = group(frames_of(positions), PixelsConfig())
    np.testing.assert_array_equal(found.labels == found.labels[0], np.arange(35) < 20)


def test_everything_at_rest_is_one_group():
    rng = np.random.default_rng(6)
    positions = np.repeat(rng.uniform(0, 400, (1, 50, 2)), 24, axis=0) + rng.normal(0, 0.2, (24, 50, 2))
    assert group(frames_of(positions), PixelsConfig()).labels.max() == 0


def test_same_input_same_output_bit_by_bit():
    positions, _ = affine_scene(np.random.default_rng(7), (40, 30))
    first, second = (group(frames_of(positions), PixelsConfig()) for _ in range(2))
    np.testing.assert_array_equal(first.labels, second.labels)
    assert first.similarity.value.tobytes() == second.similarity.value.tobytes()
    assert first.confidence.tobytes() == second.confidence.tobytes()


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_handful_of_trajectories_is_grouped_too(count):
    positions, _ = affine_scene(np.random.default_rng(8), (count,))
    assert len(group(frames_of(positions), PixelsConfig()).labels) == count


def batch(seq, stamp_ns, ids, positions):
    ids = np.asarray(ids, np.uint64)
    return builders.batch("cam", seq, stamp_ns, positions, space="cam/pixels", unit="px", ids=ids)


class Camera:
    """Two bodies at 15 Hz; trajectory i is born at `born[i]` and lost at `lost[i]`, in frames."""

    def __init__(self, born, lost, frames=40):
        self.positions, self.truth = affine_scene(np.random.default_rng(9), (40, 30), frames, 0.1)
        self.born = np.full(70, 0) if born is None else born
        self.lost = np.full(70, frames) if lost is None else lost

    def play(self, fusion, start, stop):
        updates = []
        for k in range(start, stop):
            alive = (self.born <= k) & (k < self.lost)
            stamp = T0 + k * 1000 * MS // 15
            fusion.ingest(batch(k, stamp, np.flatnonzero(alive), self.positions[k, alive]))
            updates.append(fusion.update(stamp))
        return updates


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
    camera = Camera(born, None)
    final = camera.play(pixel_fusion(), 0, 40)[-1]
    of = labels_of(final)
    hypotheses = {h.id for h in final.hypotheses}
    assert {of[3], of[50]} <= hypotheses
    # In the scene the bodies overlap in the image, so only being near something is promised.
    assert all(final.track_confidence[np.isin(final.track_id, [3, 50])] <= 0.5)


def test_nothing_is_claimed_before_there_is_something_to_compare():
    update = Camera(None, None).play(pixel_fusion(), 0, 1)[-1]
    assert (update.track_hypothesis == UNDETERMINED).all()
    assert update.hypotheses == []


def test_a_hypothesis_says_how_it_moves():
    rng = np.random.default_rng(11)
    x = rng.uniform(100, 300, (40, 2))
    fusion = pixel_fusion()
    for k in range(30):
        moved = np.concatenate([x + np.array([3.0 * k, 0.0]), x + 150.0])
        stamp = T0 + k * 1000 * MS // 15
        fusion.ingest(batch(k, stamp, np.arange(80), moved + rng.normal(0, 0.05, moved.shape)))
        update = fusion.update(stamp)
    by_state = {h.state: h for h in update.hypotheses}
    assert set(by_state) == {"moving", "static"}
    assert by_state["moving"].twist.linear == pytest.approx([45.0, 0.0], abs=0.5)
    assert by_state["moving"].twist.angular == pytest.approx(0.0, abs=0.02)
    assert by_state["static"].noise < 0.2


def test_a_restart_keeps_hypotheses():
    camera = Camera(None, None)
    fusion = pixel_fusion()
    before = camera.play(fusion, 0, 30)[-1]
    again = Fusion.restore(fusion.config, fusion.snapshot())
    after, unbroken = camera.play(again, 30, 40)[-1], camera.play(fusion, 30, 40)[-1]
    assert {h.id for h in after.hypotheses} == {h.id for h in before.hypotheses}
    np.testing.assert_array_equal(after.track_hypothesis, unbroken.track_hypothesis)
    assert [h.born_ns for h in after.hypotheses] == [h.born_ns for h in unbroken.hypotheses]


@pytest.mark.data
@pytest.mark.skipif("COMOTION_DATA" not in os.environ, reason="COMOTION_DATA names no recordings")
@pytest.mark.parametrize(
    ("name", "bodies", "worst"),
    [("hopkins155/1R2TCR", 3, 0.02), ("hopkins155/truck2", 2, 0.02), ("kt3dmoseg/Seq013_Clip01", 2, 0.05)],
)
def test_real_sequences(name, bodies, worst):
    with np.load(Path(os.environ["COMOTION_DATA"]) / f"{name}.npz") as file:
        positions, truth = file["positions"], file["labels"]
    positions = positions[evenly_spaced(len(positions), 24)]
    visible = np.isfinite(positions).all(axis=2)
    grown = np.flatnonzero(visible.sum(axis=0) >= 4)
    found = group(frames_of(positions[:, grown], visible[:, grown]), PixelsConfig())
    assert found.labels.max() + 1 == bodies
    assert misclassification(found.labels, truth[grown]) <= worst


def test_a_body_that_rests_longer_than_the_window_stays_a_hypothesis():
    rng = np.random.default_rng(16)
    place = rng.uniform(0, 400, (60, 2))
    place[40:] = rng.uniform(150, 250, (20, 2))
    fusion = pixel_fusion()
    for k in range(90):
        x = place + rng.normal(0, 0.1, place.shape)
        x[40:] += 8.0 * min(k, 15)
        stamp = T0 + k * 200 * MS
        fusion.ingest(batch(k, stamp, np.arange(60), x))
        update = fusion.update(stamp)
        if k == 20:
            moved = update
    # It moved for 3 s and has rested for 15, in a window of 10.
    for update in (moved, fusion.update(stamp)):
        assert misclassification(update.track_hypothesis, np.repeat([0, 1], [40, 20])) == 0
        assert len(update.hypotheses) == 2
    assert {h.id for h in moved.hypotheses} == {h.id for h in update.hypotheses}
