"""Stress scenes: deterministic, true to what they say; the metrics on moments made by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest

from comotion import FusionConfig
from comotion_deploy.cli import run
from comotion_experiments.stress import (
    FAMILIES,
    bodies,
    catalogue,
    events,
    features,
    find_families,
    metrics,
    run_family,
)
from comotion_experiments.stress.apart import Apart, apart
from comotion_experiments.stress.moments import Moment, moment
from comotion_experiments.stress.motion import key_states, looped, retimed, speed_profile
from comotion_experiments.stress.observe import EPOCH_NS, messages_of
from comotion_experiments.stress.scene import Happening, Scene
from comotion_schemas import UNDETERMINED, encode

SHORT = {
    "rest": {"duration": 22.0},
    "stop_and_go_10min": {"duration": 40.0},
    "ten_minutes": {"duration": 70.0},
    "late_start": {"phases": 2, "duration": 2.0},
    "late_start_rough": {"phases": 2, "duration": 2.0},
}


def scenes_of(name: str) -> list[Scene]:
    return FAMILIES[name].scenes(2, **SHORT.get(name, {}))


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_gives_the_same_messages_twice_and_every_feature_has_a_truth(name: str) -> None:
    scene, same = (scenes_of(name)[-1] for _ in range(2))
    first, again = messages_of(scene), messages_of(same)
    assert [encode(a.batch) for a in first.batches] == [encode(a.batch) for a in again.batches]
    assert first.batches
    objects = {
        (truth.source, truth.session, identity): number
        for truth in first.truth
        for identity, number in zip(truth.ids.tolist(), truth.objects.tolist(), strict=True)
    }
    for arrived in first.batches:
        batch = arrived.batch
        for identity in batch.ids.tolist():
            assert 0 <= objects[batch.source, batch.session, identity] < len(scene.bodies)
    begin, end = first.batches[0].now_ns - EPOCH_NS, first.batches[-1].now_ns - EPOCH_NS
    assert scene.start <= begin / 1e9 <= scene.start + 0.2
    assert scene.duration - 0.2 <= end / 1e9 <= scene.duration
    other = FAMILIES[name].scenes(0, **SHORT.get(name, {}))[0]
    assert not np.array_equal(scene.lives.local[:10], other.lives.local[:10]), "another seed, another scene"


def test_a_rebirth_replaces_its_share_of_every_body_at_its_instant() -> None:
    scene = events.rebirth(0, share=0.5, at=3.0, duration=4.0)[0]
    before, after = (_ids_at(scene, t) for t in (2.9, 3.01))
    assert len(before) == len(after) == scene.slots
    kept = np.intersect1d(before, after)
    bodies_kept = scene.lives.body[kept.astype(np.intp)]
    assert np.bincount(bodies_kept).tolist() == [body.features - body.features // 2 for body in scene.bodies]


def test_a_cover_hides_everything_while_the_source_goes_on() -> None:
    scene = events.cover(0, seconds=1.0, at=2.0, duration=4.0)[0]
    messages = messages_of(scene)
    counts = {round((a.now_ns - EPOCH_NS) / 1e9, 3): len(a.batch.ids) for a in messages.batches}
    assert all((count == 0) == (2.0 <= t < 3.0) for t, count in counts.items())
    assert scene.happenings == [Happening(2.0, 3.0, "lost", (0, 1, 2, 3, 4))]
    assert not np.intersect1d(_ids_at(scene, 1.9), _ids_at(scene, 3.1)).size


def test_a_restart_is_silent_then_a_new_session_counts_from_zero() -> None:
    scene = events.restart(0, silent=0.3, at=2.0, duration=4.0)[0]
    batches = messages_of(scene).batches
    times = np.array([(a.now_ns - EPOCH_NS) / 1e9 for a in batches])
    assert not ((times >= 2.0) & (times < 2.3)).any()
    sessions = [a.batch.session for a in batches]
    assert len(set(sessions)) == 2
    first = batches[sessions.index(sessions[-1])].batch
    assert sorted(first.ids.tolist()) == list(range(scene.slots))


def test_a_late_start_sees_nothing_of_what_was_before() -> None:
    early, late = events.late_start(0, phases=2, longest=3.0, duration=1.0)
    assert early.start == 0.0
    assert late.start == 3.0
    assert {a.batch.source for a in messages_of(late).batches} == {f"simulator-{k}" for k in (1, 2, 3)}


def test_a_clock_step_changes_the_stamps_of_one_source_and_not_when_they_come() -> None:
    scene = events.clock_step(0, step=0.2, at=1.0, duration=2.0)[0]
    for arrived in messages_of(scene).batches:
        error = (arrived.batch.stamp_ns - arrived.now_ns) / 1e9
        t = (arrived.now_ns - EPOCH_NS) / 1e9
        if arrived.batch.source == "simulator-1":
            assert error == 0
        else:
            assert error == pytest.approx(0.2 if t >= 1.0 else 0.005, abs=1e-6)


def test_short_lives_are_short() -> None:
    lives = features.short_lives(0, shortest=0.3, longest=1.0, duration=5.0)[0].lives
    whole = (lives.birth > 0) & (lives.death < 5.0)
    length = (lives.death - lives.birth)[whole]
    assert 0.3 - 1e-9 <= length.min() <= length.max() <= 1.0 + 1e-9


def test_gaps_keep_the_ids() -> None:
    scene = features.gaps(0, duration=4.0)[0]
    assert scene.hidden
    slot, begin, end = max(scene.hidden, key=lambda one: one[2] - one[1])
    alive = [
        {int(i) for i in a.batch.ids if scene.lives.slot[int(i)] == slot}
        for a in messages_of(scene).batches
        if begin <= (a.now_ns - EPOCH_NS) / 1e9 < end
    ]
    assert not any(alive)


def test_resting_bodies_rest_and_move_on() -> None:
    motion = retimed(
        key_states([(0.0, *[0.0] * 6), (10.0, 10.0, *[0.0] * 5)]), *speed_profile([2.0, 5.0], moving=True)
    )
    x = motion(np.array([1.0, 2.5, 4.9, 7.0])).translations[:, 0]
    assert x[0] == pytest.approx(1.0, abs=0.03)
    assert x[1] == x[2]
    assert x[3] > x[2] + 1.5


def test_a_loop_jumps_back() -> None:
    motion = looped(key_states([(0.0, *[0.0] * 6), (10.0, 10.0, *[0.0] * 5)]), 4.0)
    assert motion(np.array([5.0])).translations[0, 0] == pytest.approx(1.0)


def test_coupled_bodies_keep_their_distance_until_they_part() -> None:
    scene = bodies.coupled_pair(2, until=3.0, duration=6.0)[0]
    since = apart(scene).since
    assert 3.0 < since[1, 2] < 6.0
    leader, follower = (scene.bodies[k].motion(np.array([2.999, 3.001])) for k in (1, 2))
    for pose in (leader, follower):
        assert np.abs(np.diff(pose.translations, axis=0)).max() < 0.01


def test_a_door_is_apart_when_its_features_have_moved_by_five_sigma() -> None:
    scene = bodies.hinge(0, degrees=10.0, at=5.0, seconds=2.0)[0]
    found = apart(scene)
    assert found.components(5.0).tolist() == [0, 0]
    assert 5.1 < found.complete < 7.0
    assert found.onset(1) == found.complete
    assert apart(bodies.hinge(0, degrees=0.1)[0]).complete == np.inf


def test_hidden_objects_are_hidden_whole() -> None:
    scene = bodies.object_cover(0)[0]
    for happening in scene.happenings:
        middle = (happening.begin + happening.end) / 2
        seen = set(scene.lives.body[_ids_at(scene, middle).astype(np.intp)].tolist())
        assert seen == set(range(len(scene.bodies))) - set(happening.bodies)


def test_names_of_families_stand_for_those_that_begin_with_them() -> None:
    assert [f.name for f in find_families(["cover"])] == ["cover_1s", "cover_3s"]
    assert [f.name for f in find_families(["rest"])] == ["rest"]
    assert "image_few" in {family.name for family in find_families(["image"])}
    assert "ten_minutes" not in {f.name for f in find_families(quick=True)}
    with pytest.raises(ValueError, match="no family 'fall'"):
        find_families(["fall"])


# The metrics, on two bodies of five tracks each that are apart from t = 1 s on.
TWO = Apart(np.array([[np.inf, 1.0], [1.0, np.inf]]))
RIGHT, ONE = [1] * 5 + [2] * 5, [1] * 10


def moments_of(labels: dict[float, list[int]], **events: tuple[str, ...]) -> list[Moment]:
    where = np.repeat([0, 1], 5)
    return [
        moment(t, np.array(row), where, TWO.components(t), events=events.get(f"t{t:g}", ()))
        for t, row in labels.items()
    ]


def test_bodies_count_as_one_until_they_are_apart() -> None:
    found = moments_of({0.5: ONE, 1.5: ONE, 2.5: RIGHT})
    assert [m.nmi for m in found] == [0.0, 0.0, 1.0]
    assert [m.nmi_apart for m in found] == [1.0, 0.0, 1.0]
    assert metrics.mean_nmi(found) == pytest.approx(1 / 3)
    assert metrics.mean_nmi_apart(found, 0.0, 2.0) == 0.5
    assert metrics.all_bodies_nmi(found, TWO) == 1.0


def test_the_delay_is_from_apart_to_a_hypothesis_of_its_own() -> None:
    found = moments_of({0.5: ONE, 1.5: ONE, 2.5: RIGHT})
    assert metrics.delays(found, TWO, 3.0) == [1.5, 1.5]
    never = moments_of({0.5: ONE, 1.5: ONE, 3.0: ONE})
    assert metrics.delays(never, TWO, 3.0) == [2.0, 2.0]


def test_undetermined_tracks_are_no_hypothesis() -> None:
    found = moments_of({2.0: [UNDETERMINED] * 5 + [2] * 5})[0]
    assert metrics.majority(found, 0) is None
    assert not metrics.has_own(found, 0)
    assert metrics.has_own(found, 1)
    assert found.confirmed == {2}


def test_ids_of_an_object_count_from_its_first_own_hypothesis() -> None:
    found = moments_of({0.5: ONE, 1.5: RIGHT, 2.0: [1] * 5 + [3] * 5, 2.5: RIGHT})
    assert metrics.ids_per_object(found, TWO) == 1.5


def test_healing_takes_until_it_is_right_and_stays_so() -> None:
    event = Happening(2.0, 2.0, "change", (0, 1))
    times = np.arange(1.0, 10.0, 0.5).tolist()
    fallen = {t: (ONE if t in (2.0, 2.5, 3.5) else RIGHT) for t in times}
    assert metrics.healing(moments_of(fallen), event, 10.0) == 2.0
    assert metrics.healing(moments_of(dict.fromkeys(times, RIGHT)), event, 10.0) == 0.0
    assert metrics.healing(moments_of(dict.fromkeys(times, ONE)), event, 10.0) == 8.0
    assert np.isnan(metrics.healing(moments_of({1.0: RIGHT}), event, 10.0))


def test_ids_kept_across_an_event() -> None:
    event = Happening(2.0, 2.0, "change", (0, 1))
    assert metrics.kept(moments_of({1.0: RIGHT, 3.0: RIGHT}), event) == 1.0
    assert metrics.kept(moments_of({1.0: RIGHT, 3.0: [1] * 5 + [3] * 5}), event) == 0.5
    # One id for both bodies is the id of one of them.
    assert metrics.kept(moments_of({1.0: ONE, 3.0: ONE}), event) == 0.5


def test_true_events_are_births_and_returns() -> None:
    lost = Happening(2.0, 3.0, "object-lost", (1,))
    assert metrics.true_events(TWO, 0.5, []) == 1
    assert metrics.true_events(TWO, 5.0, []) == 2
    assert metrics.true_events(TWO, 5.0, [lost]) == 4


def test_a_run_gives_every_metric() -> None:
    found = run_family("rebirth_50", 0, FusionConfig(), at=3.0, duration=6.0)
    assert 0.3 < found["nmi"] <= 1.0
    assert found["bodies"] == pytest.approx(5.0, abs=0.5)
    assert found["ms"] > 0


def test_the_command_writes_a_page_and_a_picture(tmp_path, capsys, monkeypatch) -> None:
    out = tmp_path / "out"
    short = replace(FAMILIES["late_movers"], parameters={"first": 1.0, "every": 1.0, "duration": 4.0})
    for families in (catalogue.FAMILIES, catalogue.ALL):
        monkeypatch.setitem(families, "late_movers", short)
    options = ["--family", "late_movers", "--family", "image_planar", "--seeds", "2", "--jobs", "1", "--json"]
    assert run(["dev", "reproduce", "stress", *options, "--out", str(out)]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [(row["family"], row["seed"], len(row["errors"])) for row in shown["images"]] == [
        ("image_planar", 2, 6)
    ]
    assert [(r["family"], r["method"], r["seed"]) for r in shown["runs"]] == [
        ("late_movers", "comotion", 2),
        ("late_movers", "thesis", 2),
    ]
    page = (out / "stress.md").read_text()
    assert "| `late_movers` | start one after the other |" in page
    assert "| `image_planar` | bodies and background are planes |" in page
    assert "not all odd" in " ".join(page.split())
    assert (out / "images" / "stress.png").stat().st_size > 1000


@pytest.mark.parametrize("options", [["--family", "fall"], ["--method", "magic"], ["--seeds", "x"]])
def test_a_wrong_option_is_one_line(options: list[str], tmp_path, capsys) -> None:
    assert run(["dev", "reproduce", "stress", *options, "--out", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def _ids_at(scene: Scene, t: float) -> np.ndarray:
    """Ids in the last batch at or before a time."""
    batches = [a for a in messages_of(scene).batches if (a.now_ns - EPOCH_NS) / 1e9 <= t]
    return batches[-1].batch.ids
