"""What a space is and who says so, and a frame that moves: bodies and the camera relative to the world."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comotion import Fusion, FusionConfig
from comotion.config import SpaceConfig
from comotion.runtime.health import in_words

from .. import builders
from ..builders import MS, T0, S, play, restored

POINTS = np.random.default_rng(0).uniform(-1, 1, (12, 3))
FAR = np.random.default_rng(1).uniform(-1, 1, (40, 3))


batch = partial(builders.batch, positions=POINTS)


def pixels(source, seq, stamp_ns, count):
    return batch(source, seq, stamp_ns, positions=np.full((count, 2), 7.0), unit="px")


def rejected(fusion):
    return {source: one.rejected for (source, _), one in fusion.timeline.ledger.accounts.items()}


def test_a_batch_without_rows_claims_no_space():
    fusion = Fusion()
    claims = lambda k, now: pixels("claims", k, now - MS, 0)  # noqa: E731
    assert len(play(fusion, range(30), claims, partial(batch, "honest"))[-1].track_id) == 12
    assert rejected(fusion)["honest"] == {}
    assert rejected(fusion)["claims"]["space-mismatch"] > 25
    assert list(fusion.timeline.troubles.lately()["contradicts-space"]) == ["claims"]
    text = in_words(fusion.timeline.troubles.lately())["claims", "contradicts-space"]
    assert "says that world has unit px and dim 2, where honest says m and 3" in text


def test_the_first_that_observes_something_keeps_the_space_while_it_lives():
    fusion = Fusion()
    other = partial(pixels, "other", count=5)
    play(fusion, range(100), lambda k, now: batch("first", k, now) if k < 90 else None, other)
    assert list(fusion.timeline.troubles.lately()["contradicts-space"]) == ["other"]
    play(fusion, range(100, 300), other)
    assert rejected(fusion)["first"] == {}
    refused = rejected(fusion)["other"]["space-mismatch"]
    assert 90 < refused < 260, "released 5 s after the first has left"


def test_a_space_of_a_snapshot_is_not_free_for_the_next_best():
    before = Fusion()
    play(before, range(30), partial(batch, "first"))
    fusion, now = restored(before), T0 + S
    fusion.advance(now)
    fusion.ingest(pixels("other", 0, now, 5))
    fusion.ingest(batch("first", 30, now))
    assert len(fusion.update(now).track_id) == 12
    assert rejected(fusion)["other"] == {"space-mismatch": 1}


def test_the_configuration_decides_before_anybody_observes():
    fusion = Fusion(FusionConfig(spaces={"world": SpaceConfig(unit="m", dim=3)}))
    fusion.ingest(pixels("first", 0, T0, 5))
    fusion.ingest(batch("second", 0, T0 + MS))
    assert len(fusion.update(T0 + MS).track_id) == 12
    assert rejected(fusion)["first"] == {"space-mismatch": 1}
    fusion.ingest(pixels("first", 1, T0 + 2 * MS, 5))
    assert "the configuration says m and 3" in fusion.timeline.troubles.lately()["contradicts-space"]["first"]


def test_where_the_configuration_names_sources_others_are_refused():
    fusion = Fusion(FusionConfig(spaces={"world": SpaceConfig(sources=("first",))}))
    for source, space in (("other", "world"), ("first", "world"), ("third", "elsewhere")):
        fusion.ingest(batch(source, 0, T0, space=space))
    assert {one.name for one in fusion.update(T0).sources} == {"first", "third"}
    assert rejected(fusion) == {"other": {"space-mismatch": 1}, "first": {}, "third": {}}
    fusion.ingest(batch("other", 1, T0 + MS))
    text = in_words(fusion.timeline.troubles.lately())["other", "contradicts-space"]
    assert "says that it observes in world, where the configuration names other sources" in text


def frames(fusion, ticks, *, other):
    """A source that says nothing of the frame, and another that says `other`."""
    updates = play(
        fusion,
        ticks,
        lambda k, now: batch("honest", k, now, positions=POINTS + np.array([0.01 * k, 0, 0])),
        lambda k, now: batch("other", k, now, positions=FAR, moving=other),
    )
    return updates[-1].frames


def test_a_frame_moves_where_all_sources_say_so_and_until_they_do_not():
    fusion = Fusion()
    assert frames(fusion, range(60), other=True) == {}
    assert "is carried" in fusion.timeline.troubles.lately()["contradicts-space"]["other"]
    alone = Fusion()
    assert "world" in play(alone, range(60), partial(batch, "hand", moving=True))[-1].frames
    assert play(restored(alone), range(60, 80), partial(batch, "hand", moving=False))[-1].frames == {}


def test_the_configuration_has_the_last_word_on_whether_a_frame_moves():
    still = Fusion(FusionConfig(spaces={"world": SpaceConfig(moving=False)}))
    carried = Fusion(FusionConfig(spaces={"world": SpaceConfig(moving=True)}))
    assert frames(still, range(60), other=True) == {}
    assert "world" in frames(carried, range(60), other=False)


def test_one_source_may_open_a_fourth_of_the_spaces(monkeypatch):
    monkeypatch.setattr("comotion.spaces._MAX_SPACES", 8)
    fusion = Fusion()
    play(
        fusion,
        range(10),
        lambda k, now: batch("many", k, now, space=f"space-{k}", ids=np.arange(12) + 100 * k),
        partial(batch, "honest"),
    )
    assert sorted(fusion.spaces) == ["space-0", "space-1", "world"]
    assert rejected(fusion)["many"] == {"limit": 8}
    assert rejected(fusion)["honest"] == {}


RATE = 15
SECONDS = 6


def camera(t):
    """Pose of the camera in the world: a turn about y by up to 20 degrees, and a path of some decimetres."""
    turn = Rotation.from_rotvec([0.05 * np.sin(t), 0.35 * np.sin(0.5 * t), 0.0])
    return turn, np.array([0.2 * np.sin(0.7 * t), 0.05 * (1 - np.cos(t)), 0.05 * t])


def batches():
    """A room, and a box that slides through it at 0.1 m/s, seen by a carried camera."""
    rng = np.random.default_rng(5)
    room = rng.uniform([-1.5, -1, 2], [1.5, 1, 4], (40, 3))
    box = rng.uniform(-0.15, 0.15, (12, 3)) + np.array([-0.3, 0, 2])
    for k in range(RATE * SECONDS):
        t = k / RATE
        turn, place = camera(t)
        points = np.vstack([room, box + np.array([0.1 * t, 0, 0])])
        seen = turn.inv().apply(points - place) + rng.normal(0, 0.003, points.shape)
        yield builders.batch("hand", k, round(k * 1e9 / RATE), seen, space="hand/optical", moving=True)


@pytest.fixture(scope="module")
def carried():
    fusion, updates = Fusion(FusionConfig()), []
    for seen in batches():
        fusion.ingest(seen)
        if seen.seq % 5 == 4:
            updates.append(fusion.update(seen.stamp_ns))
    return fusion, updates


def parts(update):
    """World and box of an update."""
    return sorted((h for h in update.hypotheses if not h.absent), key=lambda h: -h.size)[:2]


def origin(updates):
    """The pose of the camera at the first update with a world: its frame is the world then."""
    return camera(next(u for u in updates if u.frames).stamp_ns * 1e-9)


def test_the_motion_of_the_camera_is_that_of_the_world_inverted(carried):
    _, updates = carried
    first, begun = origin(updates)
    for update in updates:
        if "hand/optical" not in update.frames:
            continue
        frame = update.frames["hand/optical"]
        turn, place = camera(update.stamp_ns * 1e-9)
        assert np.linalg.norm(frame.translation - first.inv().apply(place - begun)) < 0.01
        assert np.degrees((Rotation.from_quat(frame.rotation) * turn.inv() * first).magnitude()) < 1.0


def test_bodies_are_described_relative_to_the_world(carried):
    _, updates = carried
    world, box = parts(updates[-1])
    assert (world.size, world.state) == (40, "static")
    assert world.twist.linear == [0, 0, 0]
    assert (box.size, box.state) == (12, "moving")
    turn, _ = camera(updates[-1].stamp_ns * 1e-9)
    assert turn.apply(box.twist.linear) == pytest.approx([0.1, 0, 0], abs=0.03)
    age = (updates[-1].stamp_ns - box.born_ns) * 1e-9
    assert np.degrees(Rotation.from_quat(box.pose.rotation).magnitude()) < 3
    first, begun = origin(updates)
    born = np.array([-0.3 + 0.1 * box.born_ns * 1e-9, 0, 2])
    middle = first.inv().apply(born - begun)
    moved = Rotation.from_quat(box.pose.rotation).apply(middle) + box.pose.translation - middle
    assert first.apply(moved) == pytest.approx([0.1 * age, 0, 0], abs=0.03)


def test_joints_do_not_see_the_motion_of_the_camera(carried):
    _, updates = carried
    world, box = parts(updates[-1])
    (joint,) = (j for j in updates[-1].joints if {j.parent, j.child} == {world.id, box.id})
    assert joint.kind == "prismatic"
    turn, _ = camera(updates[-1].stamp_ns * 1e-9)
    assert abs(turn.apply(joint.axis)[0]) > 0.99
    assert joint.upper - joint.lower > 0.2


def test_a_restart_does_not_move_the_frame(carried):
    fusion, updates = carried
    again = Fusion.restore(fusion.config, fusion.snapshot(clean=True))
    frame = again.update(updates[-1].published_ns).frames["hand/optical"]
    assert frame.translation == pytest.approx(updates[-1].frames["hand/optical"].translation, abs=1e-3)
