"""The model behind `comotion watch`, on a clock of the test's own, and how it is drawn."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from comotion_clients.scene_model import SceneModel
from comotion_clients.watch_view import WHOLE, as_json, plain_line, render
from comotion_schemas import UNDETERMINED, Event, Problem, SourceRef, Twist

from .. import builders
from ..builders import SESSION, S, status


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


@pytest.mark.parametrize("rate", [1.0, 15.0, 200.0])
def test_a_source_has_its_rate_and_age(rate):
    model = SceneModel("lab")
    publish(model, "a", rate, 0, 10)
    row = sources(model, 10.0)["a"]
    assert row.rate == pytest.approx(rate)
    assert row.age == pytest.approx(1 / rate)
    assert row.state == "ok"


def test_a_source_stalls_comes_back_leaves_is_forgotten_and_comes_again():
    model = SceneModel("lab")
    model.on_presence("source", "a", alive=True, now=0.0)
    seq = publish(model, "a", 10, 0, 5)
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
    model.on_status(status(ages={"left": 5.0, "hangs": 5.0}))
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
    model.on_status(status(state="degraded", message="2 late"))
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
    model.on_status(status(state="degraded", message="no data from " + "x" * 300, rejected={"malformed": 7}))
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
    model.on_status(status(state="degraded", problems=[problem]))
    model.on_update(update(hypotheses=30), 0.0)
    snapshot = model.snapshot(0.0)
    assert f"clock-ahead: {text}" in plain_line(snapshot)
    assert as_json(snapshot)["service"]["problems"][0]["text"] == text
    console = Console(width=100, file=io.StringIO())
    console.print(render(snapshot, 100, WHOLE, "size", keys=False))
    assert text in " ".join(console.file.getvalue().split())
    # A screen that is not there leaves nothing out.
    assert " more " not in console.file.getvalue()
