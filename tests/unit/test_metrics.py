"""Metrics against scikit-learn, brute force and hand-made cases."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from sklearn.metrics import normalized_mutual_info_score

from comotion_clients.metrics import (
    Truth,
    bodies_of,
    label_switches,
    misclassification,
    nmi,
    score_update,
)
from comotion_schemas import UNDETERMINED, HypothesisUpdate, SourceRef, TruthBatch

from .. import builders
from ..builders import SESSION

NONE = UNDETERMINED


def partitions(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    return rng.integers(0, rng.integers(1, 7), count), rng.integers(-3, rng.integers(-2, 5), count)


def update(rows: dict[tuple[str, int], int], seq: int = 0) -> HypothesisUpdate:
    """An update that lists {(source, feature id): hypothesis}."""
    names = sorted({name for name, _ in rows})
    return builders.update(
        list(rows.values()),
        seq=seq,
        sources=[SourceRef(name=name, session=SESSION) for name in names],
        track_source=[names.index(name) for name, _ in rows],
        track_id=[feature for _, feature in rows],
    )


def truth(objects: dict[tuple[str, int], int]) -> Truth:
    return Truth(
        TruthBatch(source=name, session=SESSION, ids=[feature], objects=[number], names={})
        for (name, feature), number in objects.items()
    )


@pytest.mark.parametrize("seed", range(20))
def test_nmi_equals_scikit_learn(seed: int) -> None:
    labels, objects = partitions(seed)
    expected = normalized_mutual_info_score(objects, labels, average_method="arithmetic")
    assert nmi(labels, objects) == pytest.approx(expected, abs=1e-12)


def test_nmi_at_its_corners() -> None:
    one, many, two = np.zeros(6, int), np.arange(6), np.array([0, 0, 0, 1, 1, 1])
    assert nmi(one, one) == 1.0
    assert nmi(two, one) == 0.0
    assert nmi(one, two) == 0.0
    assert nmi(two + 5, two) == 1.0
    # Over-segmentation is penalised: I = log 2, H(C) = log 6.
    assert nmi(many, two) == pytest.approx(2 * np.log(2) / (np.log(6) + np.log(2)))
    assert np.isnan(nmi(np.empty(0, int), np.empty(0, int)))


def brute_force_errors(labels: np.ndarray, objects: np.ndarray) -> float:
    clusters, truths = np.unique(labels), np.unique(objects)
    names = list(truths) + [None] * len(clusters)
    best = 0
    for assignment in set(permutations(names, len(clusters))):
        named = dict(zip(clusters, assignment, strict=True))
        best = max(best, sum(named[c] == g for c, g in zip(labels, objects, strict=True)))
    return 1 - best / len(labels)


@pytest.mark.parametrize("seed", range(12))
def test_misclassification_equals_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    labels, objects = rng.integers(0, 4, 15), rng.integers(0, 3, 15)
    assert misclassification(labels, objects) == pytest.approx(brute_force_errors(labels, objects))


def test_linked_hypotheses_of_different_spaces_are_one_body() -> None:
    rows = {("a", 1): 5, ("a", 2): 6, ("b", 1): 1, ("b", 2): 7, ("b", 3): 6}
    said = update(rows)
    links = {5: [1, 7], 1: [5], 7: [5]}
    told = [replace(h, linked=links.get(h.id)) for h in said.hypotheses]
    linked = replace(said, hypotheses=told)
    assert bodies_of(said) == {}
    assert bodies_of(linked) == {5: 1, 1: 1, 7: 1}
    objects = truth({("a", 1): 0, ("a", 2): 1, ("b", 1): 0, ("b", 2): 0, ("b", 3): 1})
    assert score_update(said, objects).nmi < 0.8
    assert score_update(linked, objects).nmi == 1.0
    assert score_update(linked, objects).hypotheses == 2


def test_undetermined_and_unlisted_tracks_are_singletons() -> None:
    objects = {("a", i): i // 4 for i in range(8)}
    listed = {("a", 0): 1, ("a", 1): 1, ("a", 2): NONE, ("a", 4): 2, ("a", 5): 2, ("a", 6): 2}
    observed = {("a", SESSION): np.arange(8, dtype=np.uint64)}
    score = score_update(update(listed), truth(objects), observed)
    expected = normalized_mutual_info_score([0, 0, 0, 0, 1, 1, 1, 1], [1, 1, 10, 11, 2, 2, 2, 12])
    assert score.nmi == pytest.approx(expected)
    assert (score.scored, score.singletons, score.hypotheses) == (8, 3, 2)


def test_only_observed_tracks_are_scored() -> None:
    listed = {("a", 0): 1, ("a", 1): 2, ("a", 2): 2}
    observed = {("a", SESSION): np.array([1, 2], np.uint64)}
    score = score_update(update(listed), truth({("a", 0): 5, ("a", 1): 5, ("a", 2): 5}), observed)
    assert (score.scored, score.nmi) == (2, 1.0)


def test_ambiguous_and_unlabelled_tracks_are_never_scored() -> None:
    objects = {("a", 0): 1, ("a", 1): 1, ("a", 2): -1}
    listed = {("a", 0): 3, ("a", 1): 3, ("a", 2): 8, ("a", 9): 8, ("b", 0): 8}
    score = score_update(update(listed), truth(objects))
    assert (score.scored, score.nmi, score.hypotheses) == (2, 1.0, 1)


def test_label_switches_count_tracks_present_in_both() -> None:
    before = update({("a", 1): 1, ("a", 2): 1, ("a", 3): NONE, ("a", 4): 2})
    after = update({("a", 1): 1, ("a", 2): 2, ("a", 3): 2, ("b", 4): 2, ("a", 5): 2}, seq=1)
    switches = label_switches(before, after)
    assert (switches.switched, switches.common) == (2, 3)
    assert switches.per_100 == pytest.approx(200 / 3)
