"""What a newcomer gives wrongly: one clear sentence; the work has not begun then."""

import re
import sys
import types
import warnings
from collections.abc import Callable

import numpy as np
import pytest

import comotion
from comotion_schemas.transport import client_settings
from comotion_sources.runtime import SourcePublisher

TIMES = np.arange(60) / 30
NS = (TIMES * 1e9).astype(np.int64)
IDS = np.arange(30)


def scene(unit=1.0):
    """Thirty features, ten of which slide, float64 [60, 30, 3] in m / unit."""
    positions = np.repeat(np.random.default_rng(0).uniform(-1, 1, (1, 30, 3)), 60, axis=0)
    positions[:, :10, 0] += 0.4 * TIMES[:, None]
    return positions * unit


P = scene()
STRAYED = np.where((IDS[:, None] == 3) & (TIMES[:, None, None] == 1), 1e5, P)  # one is 100 km away


def publisher(unit="m", dim=3):
    """A source that is not connected."""
    return SourcePublisher("mine", space="world", unit=unit, dim=dim, connect="tcp/127.0.0.1:1")


def online(factor):
    """Push all instants with times in another unit."""
    scene = comotion.Scene()
    for k, t in enumerate(TIMES.tolist()):
        scene.push(IDS, P[k], t * factor)


def rolled(every=10):
    """Ids that are places in a list, which moves on by one now and then."""
    return np.stack([np.roll(one, k // every, axis=0) for k, one in enumerate(P)])


WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "two clocks": (
        lambda: comotion.group({"a": P, "b": P}, {"a": TIMES, "b": 1.7e9 + TIMES}),
        "sources share one clock",
    ),
    "pushed in ms": (lambda: online(1e3), "look like milliseconds"),
    "unit of the scene": (lambda: comotion.Scene("mm"), "'mm', not 'm' or 'px'; divide positions by 1000"),
    "unit of a source": (lambda: publisher("mm"), "the unit is 'mm'"),
    "pixels in space": (lambda: comotion.group(P, TIMES, unit="px"), "in px have 2 coordinates, not 3"),
    "keyword": (lambda: comotion.group(P, TIMES, windw=5), "'windw'; did you mean window?"),
    "dict": (lambda: comotion.group(P, TIMES, config={"window": -5}), "window: Input should be greater"),
    "shape": (lambda: comotion.group(P[0], TIMES), "positions have the shape (30, 3), not [T, N, 3]"),
    "too few times": (lambda: comotion.group(P, TIMES[:3]), "there are (3,) times for 60 instants"),
    "a position at infinity": (lambda: comotion.group(P + np.inf, TIMES), "a position is infinite"),
    "nothing seen": (lambda: comotion.group(P + np.nan, TIMES), "there is no observation"),
    "shape of a batch": (lambda: publisher().observe(ids=IDS, positions=P[0, :, :2]), "positions"),
    "shape of quaternions": (
        lambda: publisher().observe(ids=IDS, positions=P[0], quaternions=np.zeros((30, 3))),
        "quaternions: expected rows of 4, got 3",
    ),
    "a port": (lambda: client_settings(7447), "the endpoint is 7447, not a text as tcp/127.0.0.1:7447"),
    "no name": (lambda: publisher().name_features({1: 2}), "feature_names: {1: 2} is not texts by ids"),
    "infinite": (lambda: comotion.Scene().push(IDS, np.full((30, 3), np.inf), 0.0), "id 0 has a position"),
    "infinite, live": (lambda: publisher().observe(ids=IDS, positions=P[0] + np.inf), "id 0 has a position"),
    "a negative id": (lambda: comotion.Scene().push([-1], P[0, :1], 0.0), "id -1 is negative"),
    "too few ids": (lambda: comotion.Scene().push(IDS, P[0, :1], 0.0), "there are 30 ids for 1 positions"),
}
"""By name: a call that raises :class:`comotion.Error`, and words of its message."""

SAID: dict[str, tuple[Callable[[], object], str]] = {
    "int64 ns since a start": (lambda: comotion.group(P, NS), ""),
    "datetime64": (lambda: comotion.group(P, NS.astype("datetime64[ns]")), ""),
    "a row of NaN": (lambda: comotion.group(np.where(IDS[:, None] == 3, np.nan, P), TIMES), ""),
    "positions in mm": (lambda: comotion.group(scene(1000.0), TIMES), "if they are millimetres, divide"),
    "ids move on in a list": (
        lambda: comotion.group(rolled(), TIMES),
        "at 5 of 59 steps, first after instant 9",
    ),
    "shares of the image": (lambda: comotion.group(P[..., :2] / 100, TIMES), "if they are shares of"),
    "one a second": (lambda: comotion.group(P[..., :2] * 300, TIMES * 30.1), "give 2 or more a second"),
    "frames": (lambda: comotion.group(P, np.arange(60), period=1), "if they are frame numbers, divide"),
    "one position far out": (lambda: comotion.group(STRAYED, TIMES), "1 observation refused"),
    "far from the origin": (
        lambda: comotion.group(P + np.array([5e5, 4.2e6, 0]), TIMES),
        "positions are 4.2e+06 from the origin, where the single precision",
    ),
}
"""By name: a call that is carried out, and words of its warning; none where the input is converted."""


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_call_is_one_sentence(name):
    call, words = WRONG[name]
    with pytest.raises(comotion.Error, match=re.escape(words)) as raised:
        call()
    assert "\n" not in str(raised.value)
    assert isinstance(raised.value, ValueError)


def test_parameters_are_keywords_dicts_or_a_configuration():
    groupings = [
        comotion.group(P, TIMES, window=5, period=0.2),
        comotion.group(P, TIMES, config={"window": 5, "period": 0.2}),
        comotion.group(P, TIMES, config=comotion.FusionConfig(window=5), period=0.2),
    ]
    assert {len(one.updates) for one in groupings} == {10}
    groupings.append(comotion.group(300 * P[..., :2], TIMES))  # ten amid the rest of an image
    assert {repr(one) for one in groupings} == {"Grouping(60 x 30, 2 hypotheses, 1 at rest)"}


@pytest.mark.parametrize("name", SAID)
def test_what_is_converted_or_probably_wrong_gives_a_result_and_says_so(name):
    call, words = SAID[name]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert repr(call()).startswith("Grouping(60 x 30, ")
    assert words in " ".join(str(one.message) for one in caught)
    assert bool(words) == bool(caught)


def test_made_up_positions_are_named():
    unseen = np.random.default_rng(0).random(P.shape[:2]) < 0.1
    with pytest.warns(UserWarning, match="10% of the positions are exactly zero.*: give NaN for unseen"):
        comotion.group(np.where(unseen[..., None], 0.0, P), TIMES)
    frozen = P.copy()
    frozen[30:50, ::4] = frozen[30, ::4]
    with pytest.warns(UserWarning, match=r"\d% of the positions repeat the last ones exactly, 5 times"):
        comotion.group(frozen, TIMES)


def test_a_gap_costs_no_updates():
    times = np.r_[TIMES[:30], TIMES[30:] + 80_000]
    assert len(comotion.group(P, times).updates) < 60


def test_nan_means_unseen_everywhere():
    rows = P[0].copy()
    rows[3, 1] = np.nan
    assert 3 not in comotion.Scene().push(IDS, rows, 0.0).track_id
    whole = P.copy()
    whole[:, 3, 1] = np.nan
    assert (comotion.group(whole, TIMES).labels[:, 3] == -1).all()
    source, sent = publisher(), []
    source.put = sent.append
    source.observe(ids=IDS, positions=rows)
    assert 3 not in sent[0].ids
    assert source.dropped == {}


def test_a_scene_is_a_context_and_yields_each_update_once():
    with comotion.Scene(period=0.2) as online:
        for k, t in enumerate(TIMES.tolist()):
            online.push(IDS, P[k], t)
        with pytest.warns(UserWarning, match="source 'b': .* if they are millimetres"):
            online.push(IDS, P[-1] * 1000, TIMES[-1], source="b")
        assert len(list(online)) == 10
        assert list(online) == []
    assert len(list(online)) == 1
    with pytest.raises(comotion.Error, match="the scene is closed"):
        online.push(IDS, P[0], 3.0)


def test_a_table_has_a_row_for_each_observation(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    grouping = comotion.group(P, TIMES)
    table = grouping.to_pandas()
    assert list(table) == ["source", "time", "feature", "hypothesis", "x", "y", "z"]
    assert {len(column) for column in table.values()} == {60 * 30}
    np.testing.assert_array_equal(table["hypothesis"].reshape(60, 30), grouping.labels)
    np.testing.assert_array_equal(table["x"].reshape(60, 30), P[..., 0])


@pytest.mark.filterwarnings("ignore:at")
@pytest.mark.parametrize("every", [1, 5, 10, 20])
def test_nothing_is_certain_where_ids_change_hands(every):
    noisy = P + np.random.default_rng(1).normal(0, 0.002, P.shape)
    rolled = np.stack([np.roll(one, k // every, axis=0) for k, one in enumerate(noisy)])
    after = [one for one in comotion.group(rolled, TIMES).updates if one.stamp_ns / 1e9 > every / 30]
    assert max(float(one.track_confidence.max()) for one in after) <= 0.5
    assert comotion.group(noisy, TIMES).updates[-1].track_confidence.min() > 0.95


@pytest.mark.filterwarnings("ignore:at")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("made_of", ["white noise", "random walks", "shuffled ids"])
def test_nothing_is_ever_certain_of_data_that_makes_no_sense(made_of, seed):
    rng = np.random.default_rng(seed)
    positions = {
        "white noise": rng.normal(0, 1, P.shape),
        "random walks": P[0] + np.cumsum(rng.normal(0, 0.1, P.shape), axis=0),
        "shuffled ids": np.stack([rng.permutation(one) for one in P]),
    }
    for update in comotion.group(positions[made_of], TIMES).updates:
        assert update.track_confidence.max() < 0.5, update


@pytest.mark.parametrize("members", [2, 3, 10])
def test_small_bodies_that_make_sense_are_certain(members):
    positions = np.repeat(P[:1], len(P), axis=0)
    positions[:, :members, 0] += 0.4 * TIMES[:, None]
    grouping = comotion.group(positions + np.random.default_rng(1).normal(0, 0.005, P.shape), TIMES)
    assert grouping.updates[-1].track_confidence.min() > 0.95


def test_a_hinge_is_drawn_and_told_in_words_with_given_names():
    pytest.importorskip("matplotlib")
    rng = np.random.default_rng(0)
    door, shelf = rng.uniform(0, 1, (12, 3)) * [0.5, 0.02, 0.8], rng.uniform(-0.6, 1, (20, 3))
    times = np.arange(120) / 30
    positions = np.empty((120, 32, 3))
    for k, t in enumerate(times):
        angle, shift = 0.5 * (1 - np.cos(1.2 * t)), [0.05 * np.sin(2 * t), 0.1 * t, 0.0]
        c, s = np.cos(angle), np.sin(angle)
        turned = door @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [0.2, 0, 0]
        positions[k] = np.vstack([turned, shelf]) + shift
    grouping = comotion.group(positions + rng.normal(0, 0.001, positions.shape), times)
    names = {int(grouping.labels[-1, 0]): "door", int(grouping.labels[-1, -1]): "shelf"}
    (words,) = grouping.joints_in_words(names)
    assert re.fullmatch(r"(door turns on shelf|shelf turns on door), -?\d+ to \d+°", words)
    (legend,) = grouping.plot(names=names).legends
    assert {"door (12)", "shelf (20)", words} <= {text.get_text() for text in legend.get_texts()}


def test_an_update_is_shown_in_one_line_and_an_error_by_the_name_to_catch():
    update = comotion.group(P, TIMES).updates[-1]
    assert repr(update).endswith("30 tracks, hypotheses: 1 static (20), 2 moving (10))")
    assert f"{comotion.Error.__module__}.{comotion.Error.__name__}" == "comotion.Error"
