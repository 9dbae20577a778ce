"""Overload in, work that is left out: in a stated order, never an observation, and all again after it."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.config import ThesisConfig
from comotion.hypotheses import extent
from comotion.joints.pair import Pair
from comotion.rigid import candidates
from comotion.rigid.method import RigidMethod
from comotion.runtime.health import Arrivals, Health
from comotion.runtime.overload import Overload
from comotion.shedding import MOST, Load
from comotion_experiments.inputs import find_inputs
from comotion_experiments.offline import run_offline
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch

from .. import builders
from ..builders import labels_of

SECOND = 10**9
PERIOD = SECOND // 10


def body(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.2, 0.2, (count, 3))


def batch(k: int, positions: np.ndarray, *, first: int = 0, source: str = "a") -> ObservationBatch:
    noise = np.random.default_rng([k, first]).normal(0, 0.001, positions.shape)
    ids = np.arange(first, first + len(positions), dtype=np.uint64)
    return builders.batch(source, k, 10**18 + k * PERIOD // 2, positions + noise, ids=ids)


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
    @pytest.mark.parametrize(("level", "left_out"), [(0, 0), (1, 1), (2, 2), (4, 3), (8, 3)], ids=str)
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
        full = {"joints": 8, "boxes": 4, "searches": 5, "groupings": 20}
        expected = {"joints": 0, "boxes": 0, "searches": 4}
        for k, (what, count) in enumerate(done.items()):
            if k < left_out:
                assert count <= expected[what], what
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
    def test_of_a_large_space_some_are_grouped_and_new_ones_join_by_place_and_motion(self, method) -> None:
        fusion = Fusion(FusionConfig(method=method, thesis=ThesisConfig(sigma_switch=0.02)))
        sizes = []

        def crowd(k: int) -> np.ndarray:
            swing = np.array([0.0, 0.3 * np.sin(0.1 * max(k - 20, 0)), 0.0])
            return np.concatenate([body(250, 1), body(250, 2) + np.array([1.0, 0.0, 0.0]) + swing])

        for k in range(90):
            if k == 60:
                fusion.shed(MOST)
            fusion.ingest(batch(k, crowd(k)))
            if k >= 70:
                # Features that come up on the body that swings.
                fusion.ingest(batch(k, crowd(k)[250:260] + 0.01, first=1000, source="b"))
            if k % 2:
                update = fusion.update(10**18 + k * PERIOD // 2)
                sizes.append(len(fusion.affinity("world").tracks))
        assert sizes[28] == 500
        assert max(sizes[30:]) == 200
        labels = labels_of(update)
        rests, swings = ({labels[one] for one in ids} for ids in (range(250), range(250, 500)))
        assert (len(rests), len(swings)) == (1, 1)
        assert rests != swings
        assert {labels[1000 + one] for one in range(10)} == swings

    def test_there_may_be_many_new_ones_at_once(self) -> None:
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

    def test_the_result_of_a_small_scene_is_kept_at_the_last_level(self) -> None:
        """A scene of 56 features whose updates all take far too long: as good as one that has the time."""
        (scene,) = find_inputs(["sim:3d_4"])
        scores = {}
        for level in (0, MOST):
            fusion = Fusion(FusionConfig())
            fusion.shed(level)
            found = run_offline(scene.open(), fusion.config, fusion=fusion, duration=10.0).scores
            scores[level] = np.mean([one.nmi for one in found]), np.mean([one.hypotheses for one in found])
        assert scores[MOST][0] > scores[0][0] - 0.05
        assert scores[MOST][1] > scores[0][1] - 0.3

    def test_a_body_that_comes_up_while_searches_are_rare_is_found(self) -> None:
        fusion = Fusion(FusionConfig())
        assert groups(run(fusion, range(20))[-1]) == 1
        fusion.shed(4)
        assert groups(run(fusion, range(20, 60))[-1]) == 2


def updates(load: Load, took_s: float, start_s: float, count: int, *, busy: float = 1.0) -> list[int]:
    """Levels after updates of one kind, ten a second, that take `busy` times their processor time."""
    took_ns = round(took_s * SECOND)
    return [
        load.note(took_ns, round(took_ns / busy), round((start_s + 0.1 * k) * SECOND)) for k in range(count)
    ]


class TestLoad:
    def test_updates_in_time_change_nothing(self) -> None:
        assert set(updates(Load(PERIOD), 0.07, 0.0, 1000)) == {0}

    def test_one_slow_update_is_enough_and_slower_ones_raise_it_more(self) -> None:
        assert updates(Load(PERIOD), 0.1, 0.0, 1) == [1]
        assert updates(Load(PERIOD), 0.4, 0.0, 1) == [5]
        assert updates(Load(PERIOD), 7.0, 0.0, 3) == [MOST, MOST, MOST]

    def test_after_a_pause_of_the_machine_all_is_done_again_within_a_second(self) -> None:
        load = Load(PERIOD)
        for start_s in range(0, 100, 2):
            assert updates(load, 3.0, start_s, 1, busy=100) == [MOST]
            levels = updates(load, 0.03, start_s + 0.1, 10)
            assert levels[3] == MOST
            assert levels[4:] == 6 * [0]

    def test_after_one_costly_update_too(self) -> None:
        load = Load(PERIOD)
        updates(load, 0.03, 0.0, 10)
        assert updates(load, 1.0, 1.0, 1) == [MOST]
        assert updates(load, 0.03, 1.1, 10)[-1] == 0

    def test_after_a_long_load_all_is_done_again_within_a_second(self) -> None:
        """A machine four times as busy as before: the scene has its level; then the machine is free."""
        load = Load(PERIOD)
        for k in range(600):
            spent = round(0.04 * SECOND / 2 ** (load.level / 4))
            load.note(4 * spent, spent, k * PERIOD)
        assert load.level == 4
        assert updates(load, 0.02, 60.0, 10)[-1] == 0

    def test_it_does_not_fall_to_where_updates_would_be_slow_again(self) -> None:
        load = Load(PERIOD)
        updates(load, 0.4, 0.0, 1)
        assert set(updates(load, 0.07, 0.1, 100)) == {5}

    def test_a_level_that_was_slow_is_tried_again_now_and_then(self) -> None:
        """Done in full an update takes 0.4 s after a while, at any other level 5 ms."""
        load, slow = Load(PERIOD), []
        updates(load, 0.02, 0.0, 10)
        for k in range(10, 800):
            took = round((0.005 if load.level else 0.4) * SECOND)
            slow += [] if load.level else [k / 10]
            load.note(took, took, k * PERIOD)
        # Three times before it is believed.
        waits = np.diff(slow)
        assert waits[:2].max() < 1
        assert waits[2:].min() > 5
        assert len(waits) > 3

    def test_slow_updates_of_a_scene_find_their_level_and_stay_there(self) -> None:
        """Each level halves a cost of 0.3 s: the first that fits is kept but for a try now and then."""
        load, levels = Load(PERIOD), []
        for k in range(600):
            took = round(0.3 * SECOND / 2 ** (load.level / 2))
            levels.append(load.note(took, took, k * PERIOD))
        assert np.median(levels) == 4
        assert np.mean(np.array(levels[1:]) == 4) > 0.9


class TestOverload:
    def test_what_is_spent_counts_for_more_on_a_busy_machine(self, monkeypatch) -> None:
        load, spent = Overload(PERIOD), iter([10, 20, 30, 40])
        monkeypatch.setattr("time.thread_time_ns", lambda: next(spent))
        assert [load.cost_ns(), load.cost_ns()] == [10, 20]
        for k in range(4):
            load.note(PERIOD // 2, PERIOD // 8, k * PERIOD)
        assert load.cost_ns() == 60
        # A single pause counts for nothing.
        load.note(100 * PERIOD, PERIOD // 8, 4 * PERIOD)
        assert load.cost_ns() == 100

    def test_it_says_what_is_left_out_and_when_it_is_over(self, caplog) -> None:
        load = Overload(PERIOD)
        with caplog.at_level("INFO"):
            load.note(round(0.16 * SECOND), PERIOD // 10, 0)
            assert load.level == 2
            assert "left out are joints, axes of boxes" in load.notes()[0]
            load.note(SECOND // 100, SECOND // 100, SECOND)
        assert load.notes() == []
        assert "nothing is left out" in caplog.messages[-1]
        assert len(caplog.messages) == 2

    def test_the_status_is_degraded_and_says_why(self) -> None:
        load = Overload(PERIOD)
        load.note(PERIOD, PERIOD, 0)
        fusion = Fusion(FusionConfig())
        fusion.ingest(batch(0, scene(0)))
        fusion.update(10**18)
        fields = Health().report(
            0,
            arrivals=Arrivals({"a": 1}, {"a": 0}, ""),
            sources=fusion.timeline.sources.health(10**18, 10**18),
            stats=fusion.stats,
            notes=load.notes(),
        )
        assert fields.state == "degraded"
        assert "updates take longer than a period (level 1 of 8): left out are joints" in fields.message
