"""Which tracks are observed when, and what the scores of a run add up to."""

import math

import pytest

from comotion_clients.metrics import Truth
from comotion_clients.scoring import Observed, SpaceRef, Tally, finite_or_none
from comotion_schemas import Hypothesis, HypothesisUpdate, ObservationBatch, SourceRef, TruthBatch

from .. import messages

SESSION, OTHER = "0123456789abcdef", "f" * 16
MS = 1_000_000


def batch(
    source: str, at_ms: int, ids: list[int], *, session: str = SESSION, stamps_ms: list[int] | None = None
) -> ObservationBatch:
    return messages.batch(
        source=source,
        session=session,
        space="image" if source == "cam" else "world",
        unit="px" if source == "cam" else "m",
        dim=2 if source == "cam" else 3,
        stamp_ns=at_ms * MS,
        ids=ids,
        stamps_ns=None if stamps_ms is None else [stamp * MS for stamp in stamps_ms],
    )


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
    assert at(found, 60) == {("a", SESSION): [1, 2], ("b", SESSION): [1]}
    assert at(found, 120) == {("a", SESSION): [2, 3], ("b", SESSION): [1]}
    assert at(found, 150) == {("a", SESSION): [2, 3], ("b", SESSION): [9]}


def test_nothing_is_observed_before_the_first_batch() -> None:
    assert at(observed(batch("a", 100, [1])), 99) == {}


def test_an_outdated_batch_no_longer_counts() -> None:
    found = observed(batch("a", 0, [1]), batch("a", 100, [1]))
    assert at(found, 600) == {("a", SESSION): [1]}
    assert at(found, 601) == {}


def test_a_slow_source_counts_for_three_of_its_periods() -> None:
    found = observed(batch("slow", 0, [1]), batch("slow", 1000, [1]))
    assert at(found, 4000) == {("slow", SESSION): [1]}
    assert at(found, 4001) == {}


def test_batches_may_come_out_of_order() -> None:
    found = observed(batch("a", 100, [2]), batch("a", 0, [1]))
    assert at(found, 50) == {("a", SESSION): [1]}
    assert at(found, 100) == {("a", SESSION): [2]}


def test_a_new_session_replaces_the_old_one() -> None:
    found = observed(batch("a", 0, [1]), batch("a", 100, [1], session=OTHER))
    assert at(found, 50) == {("a", SESSION): [1]}
    assert at(found, 100) == {("a", OTHER): [1]}


def test_of_a_batch_of_several_instants_those_reached_count() -> None:
    found = observed(batch("a", 30, [1, 2, 1, 3], stamps_ms=[10, 10, 20, 30]))
    assert at(found, 9) == {}
    assert at(found, 10) == {("a", SESSION): [1, 2]}
    assert at(found, 30) == {("a", SESSION): [1, 2, 3]}


def test_memory_is_bounded_though_nobody_asks() -> None:
    found = observed(*(batch("a", k, [k]) for k in range(5000)))
    assert at(found, 5000) == {("a", SESSION): [4999]}
    assert at(found, 600) == {}


def test_spaces_are_those_of_the_sources() -> None:
    found = observed(batch("cam", 0, []), batch("a", 0, []))
    assert found.spaces == {"cam": SpaceRef("image", "px", 2), "a": SpaceRef("world", "m", 3)}


def update(at_ms: int, labels: dict[int, int]) -> HypothesisUpdate:
    ids = sorted(set(labels.values()))
    return messages.update(
        seq=at_ms,
        stamp_ns=at_ms * MS,
        period_ns=100 * MS,
        sources=[SourceRef(name="a", session=SESSION)],
        track_id=list(labels),
        track_hypothesis=list(labels.values()),
        hypotheses=[
            Hypothesis(id=i, space="world", size=1, born_ns=0, state="static", centroid=[0.0, 0.0, 0.0])
            for i in ids
        ],
    )


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


def test_updates_without_anything_to_score_do_not_count_in_the_mean() -> None:
    truth = Truth([TruthBatch(source="a", session=SESSION, ids=[1], objects=[0], names={})])
    tally = Tally(truth)
    tally.add(update(0, {}), Observed())
    tally.add(update(100, {1: 3}), observed(batch("a", 100, [1])))
    assert tally.summary().mean_nmi == 1.0
    assert (tally.summary().updates, tally.summary().scored) == (2, 1)


def test_without_truth_the_listed_hypotheses_are_counted() -> None:
    tally = Tally(Truth())
    tally.add(update(0, {1: 5, 2: 6}), observed(batch("a", 0, [1, 2])))
    summary = tally.summary()
    assert math.isnan(summary.mean_nmi)
    assert summary.mean_hypotheses == 2


def test_unknown_numbers_are_null_in_json() -> None:
    assert finite_or_none({"a": math.nan, "b": 1.5, "c": 2}) == {"a": None, "b": 1.5, "c": 2}
