"""Overload in, work that is left out: in a stated order, never an observation, and all again after it."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.hypotheses import extent
from comotion.joints.pair import Pair
from comotion.rigid import candidates
from comotion.rigid.method import RigidMethod
from comotion.runtime.health import Arrivals, Health
from comotion.runtime.overload import Overload
from comotion.shedding import FULL, MOST, Effort
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch

SECOND = 10**9
PERIOD = SECOND // 10


def body(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.2, 0.2, (count, 3))


def batch(k: int, positions: np.ndarray, *, first: int = 0, source: str = "a") -> ObservationBatch:
    noise = np.random.default_rng([k, first]).normal(0, 0.001, positions.shape)
    return ObservationBatch(
        source=source,
        session="1" * 16,
        seq=k,
        space="world",
        unit="m",
        dim=3,
        stamp_ns=10**18 + k * PERIOD // 2,
        ids=np.arange(first, first + len(positions), dtype=np.uint64),
        positions=(positions + noise).astype(np.float32),
    )


def scene(k: int) -> np.ndarray:
    """Two bodies of eight features: one rests, the other swings beside it, from the first second on."""
    swing = 0.3 * np.sin(0.1 * max(k - 20, 0))
    return np.concatenate([body(8, 1), body(8, 2) + np.array([0.5, swing, 0.0])])


def run(fusion: Fusion, frames: range) -> list[HypothesisUpdate]:
    updates = []
    for k in frames:
        fusion.ingest(batch(k, scene(k)))
        if k % 2:
            updates.append(fusion.update(10**18 + k * PERIOD // 2))
    return updates


def groups(update: HypothesisUpdate) -> int:
    return len(set(update.track_hypothesis.tolist()) - {UNDETERMINED})


class TestOrder:
    def test_each_level_leaves_out_what_the_ones_below_do(self) -> None:
        efforts = [Effort.at(level) for level in range(MOST + 1)]
        assert efforts[0] == FULL
        assert [e.joints for e in efforts] == [True] + 8 * [False]
        assert [e.boxes for e in efforts] == 2 * [True] + 7 * [False]
        assert [e.links for e in efforts] == 3 * [True] + 6 * [False]
        assert [e.search_every for e in efforts] == 4 * [1] + 5 * [5]
        assert [e.group_every for e in efforts] == 5 * [1] + [2, 4, 8, 16]

    @pytest.mark.parametrize(("level", "left_out"), [(0, 0), (1, 1), (2, 2), (4, 3), (5, 4)], ids=str)
    def test_less_is_done_level_by_level(self, level, left_out, monkeypatch) -> None:
        done = dict.fromkeys(("joints", "boxes", "searches", "groupings"), 0)

        def counted(owner, name: str, what: str) -> None:
            original = getattr(owner, name)

            def call(*args, **kwargs):
                done[what] += 1
                return original(*args, **kwargs)

            monkeypatch.setattr(owner, name, call)

        fusion = Fusion(FusionConfig())
        run(fusion, range(60))
        counted(Pair, "judge", "joints")
        counted(extent, "best_axes", "boxes")
        counted(candidates, "clusters", "searches")
        counted(RigidMethod, "partition", "groupings")
        fusion.shed(level)
        run(fusion, range(60, 100))
        full = {"joints": 8, "boxes": 4, "searches": 20, "groupings": 20}
        expected = {"joints": 0, "boxes": 0, "searches": 4 if level == 4 else 2, "groupings": 10}
        for k, (what, count) in enumerate(done.items()):
            if k < left_out:
                assert count == expected[what], what
            else:
                assert count >= full[what], what
        assert fusion.stats.shed == (20 if level else 0)


class TestObservations:
    def test_none_is_left_out(self) -> None:
        counts = []
        for level in (0, MOST):
            fusion = Fusion(FusionConfig())
            fusion.shed(level)
            updates = run(fusion, range(60))
            counts.append((fusion.stats.observations, fusion.stats.fused, len(updates[-1].track_id)))
        assert counts[0] == counts[1]

    @pytest.mark.parametrize("method", ["comotion", "thesis"])
    def test_between_groupings_members_keep_their_groups_and_new_ones_have_none(self, method) -> None:
        fusion = Fusion(FusionConfig(method=method, sigma_switch=0.02))
        before = run(fusion, range(60))[-1]
        fusion.shed(MOST)
        skipped = 0
        for k in range(60, 80):
            fusion.ingest(batch(k, scene(k)))
            fusion.ingest(batch(k, body(4, 3) + np.array([0.0, 0.0, 3.0]), first=100, source="b"))
            if not k % 2:
                continue
            update = fusion.update(10**18 + k * PERIOD // 2)
            snapshot = fusion.affinity("world")
            assert snapshot.matrix.shape == (len(snapshot.tracks),) * 2
            known = update.track_id < 100
            assert known.sum() == 16
            assert dict(
                zip(update.track_id[known].tolist(), update.track_hypothesis[known], strict=True)
            ) == (dict(zip(before.track_id.tolist(), before.track_hypothesis, strict=True)))
            fresh = update.track_hypothesis[~known]
            skipped += len(fresh) == 4 and (fresh == UNDETERMINED).all()
        assert 0 < skipped < 20

    def test_there_may_be_many_new_ones_between_groupings(self) -> None:
        fusion = Fusion(FusionConfig())
        run(fusion, range(10))
        fusion.shed(MOST)
        for k in range(10, 20):
            fusion.ingest(batch(k, scene(k)))
            crowd = np.random.default_rng(k).uniform(-1, 1, (70, 3))
            fusion.ingest(batch(k, crowd, first=100 * k, source="b"))
            update = fusion.update(10**18 + k * PERIOD // 2)
        assert len(update.track_id) > 500
        assert fusion.stats.faults == 0

    def test_a_body_that_comes_up_while_searches_are_rare_is_found(self) -> None:
        fusion = Fusion(FusionConfig())
        assert groups(run(fusion, range(20))[-1]) == 1
        fusion.shed(4)
        assert groups(run(fusion, range(20, 60))[-1]) == 2


def overloaded(load: Overload, start_s: float, count: int) -> float:
    for k in range(count):
        load.note(missed=True, at_ns=round((start_s + 0.1 * k) * SECOND))
    return start_s + 0.1 * count


class TestOverload:
    def test_single_misses_change_nothing(self) -> None:
        load = Overload()
        levels = {load.note(missed=k % 9 == 0, at_ns=k * PERIOD) for k in range(1000)}
        assert levels == {0}
        assert load.notes() == []

    def test_it_rises_step_by_step_and_returns_at_once(self, caplog) -> None:
        load = Overload()
        with caplog.at_level("INFO"):
            now = overloaded(load, 0.0, 6)
            assert load.level == 2
            assert "left out are joints, axes of boxes" in load.notes()[0]
            later = [load.note(missed=False, at_ns=round((now + 0.1 * k) * SECOND)) for k in range(60)]
        assert set(later) == {2, 0}
        assert later[30] == 2
        assert later[-1] == 0
        assert "nothing is left out" in caplog.messages[-1]
        assert len(caplog.messages) == 3

    def test_it_stops_at_the_last_level(self) -> None:
        load = Overload()
        overloaded(load, 0.0, 100)
        assert load.level == MOST

    def test_a_return_that_did_not_last_makes_the_next_one_wait_longer(self) -> None:
        load, now, waits = Overload(), 0.0, []
        for _ in range(7):
            now = overloaded(load, now, 3)
            began = now
            while load.level:
                now += 0.1
                load.note(missed=False, at_ns=round(now * SECOND))
            waits.append(round(now - began))
        assert waits == [5, 10, 20, 40, 80, 80, 80]

    def test_the_status_is_degraded_and_says_why(self) -> None:
        load = Overload()
        overloaded(load, 0.0, 3)
        fusion = Fusion(FusionConfig())
        fusion.ingest(batch(0, scene(0)))
        fusion.update(10**18)
        fields = Health().report(
            0,
            arrivals=Arrivals({"a": 1}, {"a": 0}, None),
            sources=fusion.timeline.sources.health(10**18, 10**18),
            stats=fusion.stats,
            notes=load.notes(),
        )
        assert fields.state == "degraded"
        assert "updates take longer than a period (level 1 of 8): left out are joints" in fields.message
