"""The model behind `comotion status` and `watch`, on clocks of the tests' own, and how it is drawn."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from comotion_clients.scene_model import SILENT_S, SceneModel
from comotion_clients.status import missing
from comotion_clients.watch_view import WHOLE, as_json, plain_line, render
from comotion_schemas import UNDETERMINED, Event, Problem, SourceRef, Twist

from .. import builders
from ..builders import SESSION, S

NOW = 1_000_000.0


def status(name, role="source", at=NOW, **changes):
    usual = {"stamp_ns": round(at * 1e9), "version": "1", "host": "h"}
    return builders.status(name, role, **(usual | changes))


@pytest.fixture
def model():
    """A scene with a service and a source at 30 Hz, both well."""
    scene = SceneModel("cell")
    add(scene, status("fusion", "service", rates={"cam": 30.0}))
    add(scene, status("cam"))
    return scene


def add(model, status, ahead=0.0, trip=0.002):
    """A component whose clock is ahead, and its Status, which takes half of a round trip."""
    model.on_presence(status.role, status.component, alive=True)
    model.on_status(replace(status, stamp_ns=round((NOW + ahead) * 1e9)), NOW + trip / 2, NOW + trip / 2)
    model.on_cache_answer(status.component, trip)


def rows(model):
    return {row.name: row for row in model.status(NOW).components}


def test_who_only_says_that_it_is_the_service_is_not_believed(model):
    extremes = {"rates": {"cam": 1e9}, "problems": [{"kind": "limit", "since_ns": 0, "text": "pay"}]}
    for liar in ("cam", "ghost"):
        model.on_status(status(liar, "service", NOW + 9, **extremes), NOW, NOW)
    assert "pay" not in model.status(NOW).problems
    assert (rows(model)["cam"].role, rows(model)["cam"].rate_hz) == ("source", 30.0)


@pytest.mark.parametrize("ahead", [-0.08, -0.005, 0.0, 0.012, 0.08])
@pytest.mark.parametrize("service_ahead", [0.0, 0.3, -2.0])
def test_clocks_are_told_against_the_service_within_the_error_stated(ahead, service_ahead):
    model = SceneModel("cell")
    add(model, status("fusion", "service", rates={"cam": 30.0}), ahead=service_ahead)
    add(model, status("cam"), ahead=service_ahead + ahead)
    row = rows(model)["cam"]
    assert abs(row.clock_s - ahead) <= row.clock_error_s + 1e-6
    assert row.clock_error_s < 0.005
    # Half a frame at 30 Hz is 16.7 ms.
    warned = any("the clock of source cam" in problem for problem in model.status(NOW).problems)
    assert warned == (abs(ahead) == 0.08)


def test_a_component_that_falls_silent_is_said_and_one_that_leaves_is_not(model):
    add(model, status("other"))
    model.on_presence("source", "other", alive=False)
    state = model.status(NOW + SILENT_S + 1)
    assert state.overall == "stalled"
    assert [row.name for row in state.components] == ["fusion", "cam"]
    assert "source cam is silent" in state.problems


def test_a_scene_without_a_speaking_service_is_stalled(model):
    assert SceneModel("cell").status(NOW).overall == "stalled"
    add(model, status("fusion", "service", replica="standby"))
    state = model.status(NOW)
    assert state.overall == "stalled"
    assert "none speaks" in state.problems[0]


def test_replicas_are_shown_with_their_epoch(model):
    add(model, status("fusion", "service", replica="active", epoch=7))
    assert "service fusion has no standby" in model.status(NOW).problems
    add(model, status("fusion-b", "service", replica="standby"))
    assert model.status(NOW).problems == []
    assert (rows(model)["fusion"].replica, rows(model)["fusion"].epoch) == ("active", 7)
    add(model, status("fusion-b", "service", replica="active", epoch=8))
    assert "several services speak" in model.status(NOW).problems[0]


def test_links_clocks_and_versions_are_said_before_their_effects(model):
    add(model, status("slow", state="stalled", version="0.9"))
    add(model, status("ahead"), ahead=2.0)
    link = {"whatami": "router"}
    for name, dials, sessions in (("a", 2, [link]), ("b", 0, [link]), ("c", 0, [])):
        model.on_router({"zid": name, "metadata": {"name": name, "dials": dials}, "sessions": sessions})
    beginnings = (
        "router a reaches 1 of the 2 routers",
        "router c reaches no other router",
        "the clock of source ahead",
        "versions differ",
        "source slow is stalled",
    )
    problems = model.status(NOW).problems
    assert len(problems) == len(beginnings)
    assert all(problem.startswith(words) for problem, words in zip(problems, beginnings, strict=True))


def test_what_is_expected_and_missing_is_a_problem(model):
    state = missing(model.status(NOW), ("cam", "door"))
    assert (state.overall, state.problems) == ("degraded", ["door is not there"])


@pytest.mark.parametrize(
    "described",
    [{}, {"sessions": 3, "locators": "x", "metadata": []}, {"sessions": [1]}, {"metadata": {"dials": "x"}}],
)
def test_a_router_that_says_nonsense_is_shown_as_far_as_possible(model, described):
    model.on_router(described)
    assert len(model.status(NOW).routers) == 1


def update(seq=0, hypotheses=2, events=()):
    """Four tracks of source a and two per hypothesis of source b, those of a undetermined."""
    labels = [UNDETERMINED] * 4 + [k for k in range(hypotheses) for _ in range(2 + k)]
    bodies = [builders.hypothesis(k, size=2 + k, born_ns=(90 + k) * S) for k in range(hypotheses)]
    if bodies:
        twist = Twist(linear=[0.3, 0.4, 0.0], angular=[0.0, 0.0, 0.0])
        bodies[0] = replace(bodies[0], twist=twist, linked=[1])
    return builders.update(
        labels,
        seq=seq,
        stamp_ns=100 * S,
        published_ns=100 * S + 20_000_000,
        sources=[SourceRef(name=name, session=SESSION) for name in "ab"],
        track_source=[0] * 4 + [1] * (len(labels) - 4),
        hypotheses=bodies,
        events=list(events),
    )


def publish(model, source, rate, begin, end, seq=0):
    for k in range(round((end - begin) * rate)):
        model.on_batch(builders.batch(source, seq), begin + k / rate, 0)
        seq += 1
    return seq


def sources(model, now):
    return {row.name: row for row in model.snapshot(now).sources}


def test_a_source_stalls_comes_back_leaves_is_forgotten_and_comes_again():
    model = SceneModel("lab")
    model.on_presence("source", "a", alive=True, now=0.0)
    seq = publish(model, "a", 10, 0, 5)
    row = sources(model, 5.0)["a"]
    assert (row.rate, row.age) == (pytest.approx(10), pytest.approx(0.1))
    assert sources(model, 5.85)["a"].state == "ok"
    stalled = sources(model, 6.0)["a"]
    assert (stalled.state, stalled.rate) == ("stalled", 0.0)
    publish(model, "a", 10, 8, 9, seq)
    assert sources(model, 9.0)["a"].state == "ok"
    model.on_presence("source", "a", alive=False, now=9.0)
    gone = sources(model, 10.0)["a"]
    assert (gone.state, gone.rate) == ("gone", 0.0)
    assert sources(model, 70.0) == {}
    model.on_presence("source", "a", alive=True, now=71.0)
    assert sources(model, 71.0)["a"].state == "silent"


def test_a_source_that_left_before_this_client_came_is_gone_and_one_that_hangs_is_stalled():
    model = SceneModel("lab")
    model.on_status(builders.status(ages={"left": 5.0, "hangs": 5.0}))
    model.on_presence("source", "hangs", alive=True, now=0.0)
    states = {name: row.state for name, row in sources(model, 1.0).items()}
    assert states == {"left": "gone", "hangs": "stalled"}


def test_the_service_is_absent_then_speaks_then_falls_silent():
    model = SceneModel("lab")
    assert not model.seen
    assert model.snapshot(0.0).service.state == "absent"
    for seq in range(10):
        model.on_update(update(seq), seq * 0.1)
    assert model.seen
    service = model.snapshot(1.0).service
    assert (service.state, service.seq) == ("ok", 9)
    assert service.rate == pytest.approx(10.0)
    assert service.lag == pytest.approx(0.02)
    model.on_status(builders.status(state="degraded", message="2 late"))
    assert model.snapshot(1.0).service.state == "degraded"
    assert model.snapshot(3.0).service.state == "silent"
    model.on_presence("service", "fusion", alive=False, now=3.0)
    assert model.snapshot(3.0).service.state == "absent"


def test_tracks_and_hypotheses_of_the_newest_update():
    model = SceneModel("lab")
    model.on_batch(builders.batch("b"), 0.0, 0)
    model.on_update(update(), 0.0)
    snapshot = model.snapshot(0.0)
    assert (snapshot.tracks, snapshot.undetermined) == (9, 4)
    assert {row.name: row.tracks for row in snapshot.sources} == {"b": 5}
    first, second = snapshot.hypotheses
    assert (first.id, first.size, first.age, first.unit) == (0, 2, 10.0, "m")
    assert first.speed == pytest.approx(0.5)
    assert first.confidence == pytest.approx(0.5)
    assert second.speed is None
    assert (first.linked, second.linked) == ([1], [])
    assert "linked to" in "\n".join(drawn(snapshot, 100, 24))


def test_events_are_taken_once_and_the_newest_comes_first():
    model = SceneModel("lab")
    born = Event(stamp_ns=97 * S, kind="born", hypothesis=1, others=[])
    split = Event(stamp_ns=99 * S, kind="split", hypothesis=2, others=[1])
    assert model.on_update(update(0, events=(born,)), 0.0) == [born]
    assert model.on_update(update(1, events=(born, split)), 0.1) == [split]
    rows = model.snapshot(0.1).events
    assert [(row.kind, row.ago) for row in rows] == [("split", 1.0), ("born", 3.0)]


def busy(sources, hypotheses, events):
    model = SceneModel("lab")
    for k in range(sources):
        model.on_batch(builders.batch(f"a-source-with-a-very-long-name-{k}"), 0.0, 0)
    changes = tuple(Event(stamp_ns=k, kind="merged", hypothesis=0, others=[1, k + 2]) for k in range(events))
    model.on_update(update(0, hypotheses, changes), 0.0)
    model.on_status(
        builders.status(state="degraded", message="no data from " + "x" * 300, rejected={"malformed": 7})
    )
    return model.snapshot(0.5)


def drawn(snapshot, width, height, sort="size", pose=False):
    console = Console(width=width, height=height, color_system=None, force_terminal=True)
    with console.capture() as capture:
        console.print(render(snapshot, width, height, sort, pose=pose))
    return capture.get().splitlines()


@pytest.mark.parametrize(("width", "height"), [(80, 24), (40, 12), (50, 14), (120, 40), (200, 60)])
@pytest.mark.parametrize("amount", [(0, 0, 0), (1, 2, 1), (3, 30, 9), (40, 40, 40)])
def test_the_screen_fits_the_terminal(width, height, amount):
    lines = drawn(busy(*amount), width, height)
    assert len(lines) <= height
    assert max(map(len, lines)) <= width
    assert "degraded" in lines[0]


def test_problems_are_shown_whole_where_there_is_no_screen():
    model = SceneModel("demo")
    text = "cam: its stamps are 3600.0 s ahead of this machine; " + "synchronise the clocks, " * 8 + "end"
    problem = Problem(source="cam", kind="clock-ahead", since_ns=0, text=text)
    model.on_status(builders.status(state="degraded", problems=[problem]))
    model.on_update(update(hypotheses=30), 0.0)
    snapshot = model.snapshot(0.0)
    assert f"clock-ahead: {text}" in plain_line(snapshot)
    assert as_json(snapshot)["service"]["problems"][0]["text"] == text
    console = Console(width=100, file=io.StringIO())
    console.print(render(snapshot, 100, WHOLE, "size", keys=False))
    assert text in " ".join(console.file.getvalue().split())
    # A screen that is not there leaves nothing out.
    assert " more " not in console.file.getvalue()
