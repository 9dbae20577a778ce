"""What a newcomer gives wrongly: one clear sentence, and fast; the work has not begun then."""

import re
import sys
import time
import types

import numpy as np
import pytest

import comotion

from .wrong_inputs import IDS, SAID, TIMES, WRONG, P, outcome, publisher


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """What is compiled or read from disk once is not part of an answer's time."""
    comotion.group(P, TIMES)


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_call_is_one_sentence_at_once(name):
    call, words = WRONG[name]
    begun = time.process_time()
    with pytest.raises(comotion.Error, match=re.escape(words)) as raised:
        call()
    assert time.process_time() - begun < 1
    assert "\n" not in str(raised.value)
    assert isinstance(raised.value, ValueError)


def test_parameters_are_keywords_dicts_or_a_configuration():
    found = [
        comotion.group(P, TIMES, window=5, period=0.2),
        comotion.group(P, TIMES, config={"window": 5, "period": 0.2}),
        comotion.group(P, TIMES, config=comotion.FusionConfig(window=5), period=0.2),
    ]
    assert {len(one.updates) for one in found} == {10}
    assert repr(found[0]) == "Grouping(60 x 30, 2 hypotheses, 1 at rest)"


@pytest.mark.parametrize("name", SAID)
def test_what_is_converted_or_probably_wrong_gives_a_result_and_says_so(name):
    call, words = SAID[name]
    _, said = outcome(call)
    assert "Grouping(60 x 30, " in said
    assert words in said
    assert bool(words) == said.startswith("warning: ")


def test_made_up_positions_are_named():
    unseen = np.random.default_rng(0).random(P.shape[:2]) < 0.1
    with pytest.warns(UserWarning, match="10% of the positions are exactly zero.*: give NaN for unseen"):
        comotion.group(np.where(unseen[..., None], 0.0, P), TIMES)
    frozen = P.copy()
    frozen[30:50, ::4] = frozen[30, ::4]
    with pytest.warns(
        UserWarning, match=r"\d% of the positions repeat the last ones exactly, 5 times or more"
    ):
        comotion.group(frozen, TIMES)
    with pytest.warns(UserWarning, match="subtract a fixed place amid the features"):
        comotion.Scene().push(range(P.shape[1]), P[0] + 5e6, 0.0)


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
        assert len(list(online)) == 10
        assert list(online) == []
    assert len(list(online)) == 1
    with pytest.raises(comotion.Error, match="the scene is closed"):
        online.push(IDS, P[0], 3.0)


def test_a_table_has_a_row_for_each_observation(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))
    found = comotion.group(P, TIMES)
    table = found.to_pandas()
    assert list(table) == ["source", "time", "feature", "hypothesis", "x", "y", "z"]
    assert {len(column) for column in table.values()} == {60 * 30}
    np.testing.assert_array_equal(table["hypothesis"].reshape(60, 30), found.labels)
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
    found = comotion.group(positions + np.random.default_rng(1).normal(0, 0.005, P.shape), TIMES)
    assert found.updates[-1].track_confidence.min() > 0.95


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
    found = comotion.group(positions + rng.normal(0, 0.001, positions.shape), times)
    names = {int(found.labels[-1, 0]): "door", int(found.labels[-1, -1]): "shelf"}
    (words,) = found.joints_in_words(names)
    assert re.fullmatch(r"(door turns on shelf|shelf turns on door), -?\d+ to \d+°", words)
    (legend,) = found.plot(names=names).legends
    assert {"door (12)", "shelf (20)", words} <= {text.get_text() for text in legend.get_texts()}


def test_an_update_is_shown_in_one_line_and_an_error_by_the_name_to_catch():
    update = comotion.group(P, TIMES).updates[-1]
    assert repr(update).endswith("30 tracks, hypotheses: 1 static (20), 2 moving (10))")
    assert f"{comotion.Error.__module__}.{comotion.Error.__name__}" == "comotion.Error"
