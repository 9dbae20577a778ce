"""Which tracks are observed when, and what the scores of a run add up to."""

import numpy as np
import pytest

from comotion_clients.metrics import Truth
from comotion_clients.scoring import Observed, Tally
from comotion_schemas import HypothesisUpdate, ObservationBatch, TruthBatch

from .. import builders
from ..builders import MS, SESSION


def batch(source: str, at_ms: int, ids: list[int], *, stamps_ms: list[int] | None = None, **fields):
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
        batch("a", 0, [1, 2]), batch("a", 100, [2, 3]), batch("b", 50, [1]), batch("b", 150, [9])
    )
    assert at(found, -1) == {}
    assert at(found, 60) == {("a", SESSION): [1, 2], ("b", SESSION): [1]}
    assert at(found, 120) == {("a", SESSION): [2, 3], ("b", SESSION): [1]}
    assert at(found, 150) == {("a", SESSION): [2, 3], ("b", SESSION): [9]}


def test_a_slow_source_counts_for_three_of_its_periods() -> None:
    found = observed(batch("slow", 0, [1]), batch("slow", 1000, [1]))
    assert at(found, 4000) == {("slow", SESSION): [1]}
    assert at(found, 4001) == {}


def test_of_a_batch_of_several_instants_those_reached_count() -> None:
    found = observed(batch("a", 30, [1, 2, 1, 3], stamps_ms=[10, 10, 20, 30]))
    assert at(found, 9) == {}
    assert at(found, 10) == {("a", SESSION): [1, 2]}
    assert at(found, 30) == {("a", SESSION): [1, 2, 3]}


def update(at_ms: int, labels: dict[int, int]) -> HypothesisUpdate:
    return builders.update(list(labels.values()), seq=at_ms, stamp_ns=at_ms * MS, track_id=list(labels))


def test_a_run_adds_up() -> None:
    truth = Truth([TruthBatch(source="a", session=SESSION, ids=[1, 2, 3, 4], objects=[0, 0, 1, 1], names={})])
    found = observed(*(batch("a", t, [1, 2, 3, 4]) for t in (0, 100, 200)))
    tally = Tally(truth)
    tally.add(update(0, {1: 5, 2: 5, 3: 5, 4: 5}), found)
    tally.add(update(100, {1: 5, 2: 5, 3: 6, 4: 6}), found)
    tally.add(update(200, {1: 5, 2: 5, 3: 6, 4: 6}), found)
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
    score = tally.add(update(0, {}), observed(batch("a", 0, [1, 2])))
    assert (score.nmi, score.singletons) == (0.0, 2)
