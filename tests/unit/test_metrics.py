"""Metrics and the scores of a run: against scikit-learn, TrackEval, brute force and hand-made cases."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from sklearn.metrics import normalized_mutual_info_score

from comotion_clients.metrics import Truth, bodies_of, label_switches, misclassification, nmi, score_update
from comotion_clients.scoring import Observed, Tally
from comotion_clients.tracking import Tracking
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch, SourceRef, TruthBatch

from .. import builders
from ..builders import MS, SESSION

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


def test_nmi_of_nothing_is_not_known() -> None:
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


def observation(source: str, at_ms: int, ids: list[int], *, stamps_ms: list[int] | None = None, **fields):
    space, unit, dim = ("image", "px", 2) if source == "cam" else ("world", "m", 3)
    stamps = None if stamps_ms is None else [stamp * MS for stamp in stamps_ms]
    kind = {"space": space, "unit": unit, "ids": ids, "stamps_ns": stamps}
    return builders.batch(source, 0, at_ms * MS, np.zeros((len(ids), dim)), **(kind | fields))


def observed(*batches: ObservationBatch) -> Observed:
    found = Observed()
    for one in batches:
        found.add(one)
    return found


def at(found: Observed, ms: int) -> dict[tuple[str, str], list[int]]:
    return {key: ids.tolist() for key, ids in found.at(ms * MS).items()}


def test_the_newest_batch_of_every_source_counts() -> None:
    found = observed(
        observation("a", 0, [1, 2]),
        observation("a", 100, [2, 3]),
        observation("b", 50, [1]),
        observation("b", 150, [9]),
    )
    assert at(found, -1) == {}
    assert at(found, 60) == {("a", SESSION): [1, 2], ("b", SESSION): [1]}
    assert at(found, 120) == {("a", SESSION): [2, 3], ("b", SESSION): [1]}
    assert at(found, 150) == {("a", SESSION): [2, 3], ("b", SESSION): [9]}


def test_a_slow_source_counts_for_three_of_its_periods() -> None:
    found = observed(observation("slow", 0, [1]), observation("slow", 1000, [1]))
    assert at(found, 4000) == {("slow", SESSION): [1]}
    assert at(found, 4001) == {}


def test_of_a_batch_of_several_instants_those_reached_count() -> None:
    found = observed(observation("a", 30, [1, 2, 1, 3], stamps_ms=[10, 10, 20, 30]))
    assert at(found, 9) == {}
    assert at(found, 10) == {("a", SESSION): [1, 2]}
    assert at(found, 30) == {("a", SESSION): [1, 2, 3]}


def labelled(at_ms: int, labels: dict[int, int]) -> HypothesisUpdate:
    return builders.update(list(labels.values()), seq=at_ms, stamp_ns=at_ms * MS, track_id=list(labels))


def test_a_run_adds_up() -> None:
    truth = Truth([TruthBatch(source="a", session=SESSION, ids=[1, 2, 3, 4], objects=[0, 0, 1, 1], names={})])
    found = observed(*(observation("a", t, [1, 2, 3, 4]) for t in (0, 100, 200)))
    tally = Tally(truth)
    tally.add(labelled(0, {1: 5, 2: 5, 3: 5, 4: 5}), found)
    tally.add(labelled(100, {1: 5, 2: 5, 3: 6, 4: 6}), found)
    tally.add(labelled(200, {1: 5, 2: 5, 3: 6, 4: 6}), found)
    summary = tally.summary()
    assert [score.nmi for score in tally.scores] == [0.0, 1.0, 1.0]
    assert summary.mean_nmi == pytest.approx(2 / 3)
    assert summary.final_nmi == 1.0
    assert summary.mean_misclassification == pytest.approx(0.5 / 3)
    assert summary.mean_hypotheses == pytest.approx(5 / 3)
    assert summary.mean_objects == 2
    assert summary.switches_per_100 == pytest.approx(100 * 2 / 8)
    assert (summary.updates, summary.scored) == (3, 3)


def test_an_empty_update_of_an_observed_scene_is_scored_as_singletons() -> None:
    truth = Truth([TruthBatch(source="a", session=SESSION, ids=[1, 2], objects=[0, 0], names={})])
    tally = Tally(truth)
    score = tally.add(labelled(0, {}), observed(observation("a", 0, [1, 2])))
    assert (score.nmi, score.singletons) == (0.0, 2)


def figures(instants):
    tracking = Tracking()
    for labels, objects in instants:
        tracking.add(np.array(labels, np.int64), np.array(objects, np.int32))
    return tracking.figures()


def test_what_is_right_has_the_best_figures():
    found = figures([([7, 7, 9], [0, 0, 1])] * 5)
    assert (found.hota, found.idf1, found.id_switches) == (1.0, 1.0, 0)


def test_undetermined_and_unknown_features_are_no_detections():
    found = figures([([UNDETERMINED, UNDETERMINED, 3], [0, 0, -1])] * 3)
    assert (found.hota, found.idf1, found.id_switches) == (0.0, 0.0, 0)
    assert figures([]).hota == 0.0


def test_figures_are_those_of_trackeval():
    pytest.importorskip("trackeval")
    from trackeval.metrics import CLEAR, HOTA, Identity

    rng = np.random.default_rng(3)
    truth = np.repeat(np.arange(4), 6)
    instants = []
    for t in range(40):
        labels = np.where(rng.random(24) < 0.3, rng.integers(10, 16, 24), truth + 10 + (t // 15))
        seen = rng.random(24) < 0.8
        instants.append((labels[seen], truth[seen]))
    ours = figures(instants)
    hota, idf1, clear = (m().eval_sequence(_as_trackeval(instants)) for m in (HOTA, Identity, CLEAR))
    assert ours.hota == pytest.approx(hota["HOTA"].mean())
    assert (ours.det_a, ours.ass_a) == pytest.approx((hota["DetA"].mean(), hota["AssA"].mean()))
    assert ours.idf1 == pytest.approx(idf1["IDF1"])
    assert ours.id_switches == clear["IDSW"] > 0


def _as_trackeval(instants):
    data = {"gt_ids": [], "tracker_ids": [], "similarity_scores": []}
    for labels, objects in instants:
        true, found = np.unique(objects), np.unique(labels)
        masks = (objects == true[:, None])[:, None, :], (labels == found[:, None])[None]
        data["gt_ids"].append(true)
        data["tracker_ids"].append(found - 10)
        data["similarity_scores"].append((masks[0] & masks[1]).sum(2) / (masks[0] | masks[1]).sum(2))
    for name, key in (("gt", "gt_ids"), ("tracker", "tracker_ids")):
        data[f"num_{name}_dets"] = sum(map(len, data[key]))
        data[f"num_{name}_ids"] = int(max(ids.max() for ids in data[key])) + 1
    data["num_timesteps"] = len(instants)
    return data
