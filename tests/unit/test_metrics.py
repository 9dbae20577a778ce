"""Metrics and the scores of a run: against scikit-learn, TrackEval, brute force and hand-made cases."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from comotion_clients.metrics import Truth, bodies_of, label_switches, misclassification, nmi, score_update
from comotion_clients.scoring import Observed, Scoring
from comotion_clients.tracking import Tracking
from comotion_schemas import UNDETERMINED, SourceRef, TruthBatch

from .. import builders
from ..builders import MS, SESSION

NONE = UNDETERMINED


def update(rows, seq=0):
    """An update that lists {(source, feature id): hypothesis}."""
    names = sorted({name for name, _ in rows})
    return builders.update(
        list(rows.values()),
        seq=seq,
        sources=[SourceRef(name=name, session=SESSION) for name in names],
        track_source=[names.index(name) for name, _ in rows],
        track_id=[feature for _, feature in rows],
    )


def truth(objects):
    return Truth(
        TruthBatch(source=name, session=SESSION, ids=[feature], objects=[number], names={})
        for (name, feature), number in objects.items()
    )


@pytest.mark.parametrize("seed", range(20))
def test_nmi_equals_scikit_learn_and_of_nothing_is_not_known(seed):
    from sklearn.metrics import normalized_mutual_info_score

    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    labels, objects = rng.integers(0, rng.integers(1, 7), count), rng.integers(-3, rng.integers(-2, 5), count)
    expected = normalized_mutual_info_score(objects, labels, average_method="arithmetic")
    assert nmi(labels, objects) == pytest.approx(expected, abs=1e-12)
    assert np.isnan(nmi(np.empty(0, int), np.empty(0, int)))


def brute_force_errors(labels, objects):
    clusters, truths = np.unique(labels), np.unique(objects)
    names = list(truths) + [None] * len(clusters)
    best = 0
    for assignment in set(permutations(names, len(clusters))):
        named = dict(zip(clusters, assignment, strict=True))
        best = max(best, sum(named[c] == g for c, g in zip(labels, objects, strict=True)))
    return 1 - best / len(labels)


@pytest.mark.parametrize("seed", range(12))
def test_misclassification_equals_brute_force(seed):
    rng = np.random.default_rng(seed)
    labels, objects = rng.integers(0, 4, 15), rng.integers(0, 3, 15)
    assert misclassification(labels, objects) == pytest.approx(brute_force_errors(labels, objects))


def test_linked_hypotheses_of_different_spaces_are_one_body():
    rows = {("a", 1): 5, ("a", 2): 6, ("b", 1): 1, ("b", 2): 7, ("b", 3): 6}
    unlinked = update(rows)
    links = {5: [1, 7], 1: [5], 7: [5]}
    hypotheses = [replace(h, linked=links.get(h.id)) for h in unlinked.hypotheses]
    linked = replace(unlinked, hypotheses=hypotheses)
    assert bodies_of(unlinked) == {}
    assert bodies_of(linked) == {5: 1, 1: 1, 7: 1}
    objects = truth({("a", 1): 0, ("a", 2): 1, ("b", 1): 0, ("b", 2): 0, ("b", 3): 1})
    assert score_update(unlinked, objects).nmi < 0.8
    assert score_update(linked, objects).nmi == 1.0
    assert score_update(linked, objects).hypotheses == 2


OF_A = {("a", i): i // 4 for i in range(8)}
# Labels listed, true objects, features observed (if told); then scored, singletons, hypotheses and NMI.
SCORED = {
    "undetermined and unlisted tracks are singletons": (
        {("a", 0): 1, ("a", 1): 1, ("a", 2): NONE, ("a", 4): 2, ("a", 5): 2, ("a", 6): 2},
        OF_A,
        range(8),
        (8, 3, 2, nmi(np.repeat([0, 1], 4), np.array([1, 1, 10, 11, 2, 2, 2, 12]))),
    ),
    "only observed tracks are scored": (
        {("a", 0): 1, ("a", 1): 2, ("a", 2): 2},
        dict.fromkeys(OF_A, 5),
        [1, 2],
        (2, 0, 1, 1.0),
    ),
    "ambiguous and unlabelled tracks are never scored": (
        {("a", 0): 3, ("a", 1): 3, ("a", 2): 8, ("a", 9): 8, ("b", 0): 8},
        {("a", 0): 1, ("a", 1): 1, ("a", 2): -1},
        None,
        (2, 0, 1, 1.0),
    ),
    "an empty update is scored as singletons": ({}, {("a", 1): 0, ("a", 2): 0}, [1, 2], (2, 2, 0, 0.0)),
}


@pytest.mark.parametrize(("listed", "objects", "seen", "expected"), SCORED.values(), ids=SCORED)
def test_tracks_that_count(listed, objects, seen, expected):
    observed = None if seen is None else {("a", SESSION): np.array(seen, np.uint64)}
    score = score_update(update(listed), truth(objects), observed)
    assert (score.scored, score.singletons, score.hypotheses) == expected[:3]
    assert score.nmi == pytest.approx(expected[3])


def test_label_switches_count_tracks_present_in_both():
    before = update({("a", 1): 1, ("a", 2): 1, ("a", 3): NONE, ("a", 4): 2})
    after = update({("a", 1): 1, ("a", 2): 2, ("a", 3): 2, ("b", 4): 2, ("a", 5): 2}, seq=1)
    assert label_switches(before, after) == (2, 3)


def observation(source, at_ms, ids, *, stamps_ms=None, **fields):
    space, unit, dim = ("image", "px", 2) if source == "cam" else ("world", "m", 3)
    stamps = None if stamps_ms is None else [stamp * MS for stamp in stamps_ms]
    kind = {"space": space, "unit": unit, "ids": ids, "stamps_ns": stamps}
    return builders.batch(source, 0, at_ms * MS, np.zeros((len(ids), dim)), **(kind | fields))


def test_features_count_as_observed_in_the_newest_batch_of_their_source_for_three_of_its_periods():
    observed = Observed()
    for batch in (
        observation("a", 0, [1, 2]),
        observation("a", 100, [2, 3]),
        observation("b", 50, [1]),
        observation("b", 150, [9]),
        observation("slow", 0, [1]),
        observation("slow", 1000, [1]),
        # Of a batch of several instants those reached count.
        observation("many", 230, [1, 2, 1, 3], stamps_ms=[210, 210, 220, 230]),
    ):
        observed.add(batch)
    of_slow = {"slow": [1]}
    for ms, expected in {
        -1: {},
        60: {"a": [1, 2], "b": [1]} | of_slow,
        120: {"a": [2, 3], "b": [1]} | of_slow,
        150: {"a": [2, 3], "b": [9]} | of_slow,
        210: {"a": [2, 3], "b": [9], "many": [1, 2]} | of_slow,
        230: {"a": [2, 3], "b": [9], "many": [1, 2, 3]} | of_slow,
        4000: of_slow,
        4001: {},
    }.items():
        assert {name: ids.tolist() for (name, _), ids in observed.at(ms * MS).items()} == expected, ms


def test_a_run_adds_up():
    truth = Truth([TruthBatch(source="a", session=SESSION, ids=[1, 2, 3, 4], objects=[0, 0, 1, 1], names={})])
    scoring = Scoring(truth)
    for at_ms, labels in ((0, [5, 5, 5, 5]), (100, [5, 5, 6, 6]), (200, [5, 5, 6, 6])):
        scoring.add(observation("a", at_ms, [1, 2, 3, 4]))
        scoring.score(builders.update(labels, seq=at_ms, stamp_ns=at_ms * MS, track_id=[1, 2, 3, 4]))
    summary = scoring.summary
    assert [score.nmi for score in scoring.scores] == [0.0, 1.0, 1.0]
    assert summary.mean_nmi == pytest.approx(2 / 3)
    assert summary.final_nmi == 1.0
    assert summary.mean_misclassification == pytest.approx(0.5 / 3)
    assert summary.mean_hypotheses == pytest.approx(5 / 3)
    assert summary.mean_objects == 2
    assert summary.switches_per_100 == pytest.approx(100 * 2 / 8)
    assert (summary.updates, summary.scored) == (3, 3)


def figures(instants):
    tracking = Tracking()
    for labels, objects in instants:
        tracking.add(np.array(labels, np.int64), np.array(objects, np.int32))
    return tracking.figures()


def test_figures_are_those_of_trackeval():
    """As TrackEval 1.3.0 gave them for these instants."""
    rng = np.random.default_rng(3)
    truth = np.repeat(np.arange(4), 6)
    instants = []
    for t in range(40):
        labels = np.where(rng.random(24) < 0.3, rng.integers(10, 16, 24), truth + 10 + (t // 15))
        seen = rng.random(24) < 0.8
        instants.append((labels[seen], truth[seen]))
    measured = figures(instants)
    assert measured.hota == pytest.approx(0.2629558528491275)
    assert (measured.det_a, measured.ass_a) == pytest.approx((0.45185053762566163, 0.15365402121746463))
    assert (measured.idf1, measured.id_switches) == (pytest.approx(2 / 7), 12)
