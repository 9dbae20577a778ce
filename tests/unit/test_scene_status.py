"""The model behind `comotion status`: states, clocks, problems."""

from dataclasses import replace

import pytest

from comotion_clients.scene_model import SILENT_S, SceneModel
from comotion_clients.status import missing

from .. import builders

NOW = 1_000_000.0


def status(name, role="source", at=NOW, **changes):
    usual = {"stamp_ns": round(at * 1e9), "version": "1", "host": "h"}
    return builders.status(name, role, **(usual | changes))


@pytest.fixture
def model():
    """A scene with a service and a source at 30 Hz, both well."""
    found = SceneModel("cell")
    add(found, status("fusion", "service", rates={"cam": 30.0}))
    add(found, status("cam"))
    return found


def add(model, one, ahead=0.0, trip=0.002):
    """A component whose clock is ahead, and its Status, which takes half of a round trip."""
    model.on_presence(one.role, one.component, alive=True)
    model.on_status(replace(one, stamp_ns=round((NOW + ahead) * 1e9)), NOW + trip / 2, NOW + trip / 2)
    model.on_cache_answer(one.component, trip)


def rows(model):
    return {row.name: row for row in model.status(NOW).components}


def test_a_scene_that_is_well_has_no_problems(model):
    found = model.status(NOW)
    assert (found.overall, found.problems) == ("ok", [])
    assert rows(model)["cam"].rate_hz == 30.0


def test_who_only_says_that_it_is_the_service_is_not_believed(model):
    said = {"rates": {"cam": 1e9}, "problems": [{"kind": "limit", "since_ns": 0, "text": "pay"}]}
    for liar in ("cam", "ghost"):
        model.on_status(status(liar, "service", NOW + 9, **said), NOW, NOW)
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
    found = model.status(NOW + SILENT_S + 1)
    assert found.overall == "stalled"
    assert [row.name for row in found.components] == ["fusion", "cam"]
    assert "source cam is silent" in found.problems


def test_a_scene_without_a_speaking_service_is_stalled(model):
    assert SceneModel("cell").status(NOW).overall == "stalled"
    add(model, status("fusion", "service", replica="standby"))
    found = model.status(NOW)
    assert found.overall == "stalled"
    assert "none speaks" in found.problems[0]


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
    assert all(one.startswith(words) for one, words in zip(problems, beginnings, strict=True))


def test_what_is_expected_and_missing_is_a_problem(model):
    found = missing(model.status(NOW), ("cam", "door"))
    assert (found.overall, found.problems) == ("degraded", ["door is not there"])


@pytest.mark.parametrize(
    "described",
    [{}, {"sessions": 3, "locators": "x", "metadata": []}, {"sessions": [1]}, {"metadata": {"dials": "x"}}],
)
def test_a_router_that_says_nonsense_is_shown_as_far_as_possible(model, described):
    model.on_router(described)
    assert len(model.status(NOW).routers) == 1


def test_who_speaks_is_looked_for_once_however_many_there_are(model, monkeypatch):
    asked = []
    speaking = SceneModel.service.fget
    monkeypatch.setattr(SceneModel, "service", property(lambda one: asked.append(1) or speaking(one)))
    model.status(NOW)
    once = len(asked)
    for number in range(20):
        add(model, status(f"cam-{number}"))
    asked.clear()
    model.status(NOW)
    assert len(asked) == once
