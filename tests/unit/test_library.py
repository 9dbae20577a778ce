"""The library gives what the processes give, and converts times where their unit is certain."""

import datetime
import json
import re
from pathlib import Path

import numpy as np
import pytest

import comotion
from comotion import FusionConfig
from comotion_experiments.offline import run_offline
from comotion_schemas import ObservationBatch
from comotion_schemas.errors import Error
from comotion_schemas.time_units import instant, seconds
from comotion_schemas.transport import SessionSettings
from comotion_sources import simulator
from comotion_sources.runtime import SourcePublisher

CONFIG = FusionConfig(period=0.2)


def same(update, other):
    """The same but for the names of spaces and sources."""
    for name in ("stamp_ns", "published_ns", "seq", "events"):
        assert getattr(update, name) == getattr(other, name)
    for name in ("track_id", "track_hypothesis", "track_confidence", "track_position"):
        np.testing.assert_array_equal(getattr(update, name), getattr(other, name))
    assert [h.__dict__ | {"space": ""} for h in update.hypotheses] == [
        h.__dict__ | {"space": ""} for h in other.hypotheses
    ]


@pytest.fixture(scope="module")
def scene():
    """Positions [T, N, 3], times [T] and true objects [N] of a simulated scene, and its messages."""
    simulated = simulator.simulate(simulator.load_scene("3d_2"), seed=1)
    batches = [m for m in simulator.batches(simulated) if isinstance(m, ObservationBatch)][:45]
    count = 1 + max(int(b.ids.max()) for b in batches)
    positions = np.full((len(batches), count, 3), np.nan)
    for k, batch in enumerate(batches):
        positions[k, batch.ids.astype(int)] = batch.positions
    return positions, np.array([b.stamp_ns / 1e9 for b in batches]), batches


def test_a_simulated_scene_gives_the_last_update_of_evaluate(scene, tmp_path):
    positions, times, batches = scene
    groups = comotion.group(positions, times, config=CONFIG)
    same(groups.updates[-1], run_offline(batches, CONFIG).last)
    final = groups.labels[-1]
    assert len(set(final[final >= 0].tolist())) >= 2
    assert groups.hypotheses == groups.updates[-1].hypotheses
    np.testing.assert_array_equal(np.asarray(groups), groups.labels)
    moving = next(h for h in groups.hypotheses if h.state == "moving")
    track = groups.poses[moving.id]
    assert track.times[-1] == pytest.approx(times[-1], abs=0.1)
    assert track.rotation.shape == (len(track.times), 4)
    assert track.translation[-1] == pytest.approx(moving.pose.translation)
    pytest.importorskip("matplotlib")
    groups.plot(tmp_path / "bodies.png")
    assert (tmp_path / "bodies.png").stat().st_size > 10_000


def test_several_sources_are_one_scene(scene):
    positions, times, _ = scene
    parts = {"a": positions[:, ::2], "b": positions[::2, 1::2]}
    groups = comotion.group(parts, {"a": times, "b": times[::2]})
    assert all(groups.by_source[name].shape == part.shape[:2] for name, part in parts.items())
    shared = set(groups.by_source["a"][-1].tolist()) & set(groups.by_source["b"][-1].tolist())
    assert len(shared - {-1}) >= 2
    with pytest.raises(ValueError, match="2 sources: use by_source"):
        _ = groups.labels


def test_bad_rows_are_left_out_and_counted_on_request():
    forgiving = comotion.Scene(drop_invalid=True)
    forgiving.push([1, 2, 3, -4], [[0, 0, 0], [np.nan] * 3, [1, np.inf, 0], [2, 2, 2]], 0.0)
    assert forgiving.dropped == {"range": 1, "non-finite": 1}
    assert forgiving.update().track_id.tolist() == [1]
    with pytest.raises(ValueError, match="does not increase"):
        forgiving.push([1], [[0, 0, 0]], 0.0)
    with pytest.raises(ValueError, match="positions have 2 coordinates, those before had 3"):
        forgiving.push([1], [[0, 0]], 1.0)


def test_the_notebook_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    book = json.loads((Path(__file__).parents[2] / "docs/examples/library.ipynb").read_text())
    monkeypatch.chdir(tmp_path)
    names = {}
    for cell in book["cells"]:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), "library.ipynb", "exec"), names)
    assert "moving 12 features" in capsys.readouterr().out
    assert (tmp_path / "bodies.png").stat().st_size > 10_000
    assert names["grouping"].plot()._repr_png_().startswith(b"\x89PNG")  # which a notebook shows
    assert names["scene"].dropped == {}
    assert sum(h.state == "moving" for h in names["update"].hypotheses) == 1


def publisher(**options):
    """A source that is not connected, and what it puts."""
    source, sent = SourcePublisher("mine", space="world", unit="m", dim=3, **options), []
    source.put = sent.append
    return source, sent


def test_a_source_takes_ordinary_data():
    source, sent = publisher(drop_invalid=True)
    source.observe(ids=[5, -1, 6], positions=[[0, 0, 0], [1, 1, 1], [np.inf, 0, 0]], sigma=[0.1, 0.2, 0.3])
    (batch,) = sent
    assert (batch.ids.tolist(), batch.sigma.tolist()) == ([5], [pytest.approx(0.1)])
    assert source.dropped == {"range": 1, "non-finite": 1}
    with pytest.raises(ValueError, match="connect or settings"):
        SourcePublisher("mine", space="w", unit="m", dim=3, connect="tcp/x:1", settings=SessionSettings())


def test_a_source_says_that_positions_are_too_far_from_the_origin(caplog):
    source, _ = publisher()
    places = np.random.default_rng(0).normal(size=(9, 3)) + np.array([5e5, 4.2e6, 0])
    for k in range(2):
        source.observe(ids=range(9), positions=places, stamp_ns=k)
    (record,) = caplog.records
    assert "positions are 4.2e+06 from the origin" in record.message


def test_a_batch_of_several_instants_repeats_ids_and_drops_rows():
    source, sent = publisher(drop_invalid=True)
    points = [[0, 0, 0], [0, 0, 1], [0, np.nan, 2]]
    source.observe(ids=[5, 5, 5], positions=points, stamp_ns=30, stamps_ns=[10, 20, 30])
    (batch,) = sent
    assert (batch.stamp_ns, batch.ids.tolist(), batch.stamps_ns.tolist()) == (20, [5, 5], [10, 20])
    with pytest.raises(ValueError, match="id is used twice"):
        source.observe(ids=[5, 5], positions=points[:2], stamp_ns=30)


T = np.arange(60) / 30
NS = (T * 1e9).astype(np.int64)
START = np.datetime64("2024-01-01")
UNIX = 1_704_067_200


@pytest.mark.parametrize(
    ("times", "origin"),
    [
        (T, 0),
        (UNIX + T, UNIX),
        (UNIX * 10**9 + NS, UNIX),
        (NS // 1000, 0),
        (NS.astype(np.uint64) + np.uint64(8 * 10**14), 8e5),
        (NS + 2 * 10**12, 2000),
        (START + NS.astype("timedelta64[ns]"), UNIX),
        (NS.astype("timedelta64[ns]"), 0),
        ([datetime.datetime(2024, 1, 1) + datetime.timedelta(seconds=t) for t in T.tolist()], UNIX),
    ],
)
def test_a_certain_unit_is_converted(times, origin):
    np.testing.assert_allclose(seconds(times) - origin, T, atol=2e-6)


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (T * 1e3, "look like milliseconds (30 Hz): divide by 1000"),
        (UNIX + 5 * np.arange(60), "one instant in 5 s is too seldom"),
        (T * 1e9 + 2e9, "look like nanoseconds (30 Hz)"),
        (T * 3e4, "milliseconds (1 Hz): divide by 1000 or microseconds (1e+03 Hz)"),
        (T[::-1], "times do not increase: number 1 (1.93333333) comes after 1.96666667; 59 of 60"),
        (np.where(T > 1, np.nan, T), "time number 31 is not finite (29 of 60 are not)"),
        (np.r_[0.0, UNIX + T], "after number 0 (0 s) times jump by 1.97e+04 days"),
        (np.array(["NaT", "2024-01-01"], "datetime64[s]"), "time number 0 is not finite"),
        (["a", "b"], "not numbers"),
        (T[None], "times have the shape (1, 60), not [T]"),
    ],
)
def test_any_other_is_one_error_that_guesses(times, words):
    with pytest.raises(Error, match=re.escape(words)):
        seconds(times)


@pytest.mark.parametrize(
    "time", [UNIX, UNIX * 1000, np.int64(UNIX) * 10**9, START, datetime.datetime(2024, 1, 1)]
)
def test_one_instant_is_converted(time):
    assert instant(time) == UNIX


@pytest.mark.parametrize("time", [None, "now", float("nan"), [1.0], 8.6e14])
def test_what_is_no_instant_is_an_error(time):
    with pytest.raises(Error):
        instant(time)
