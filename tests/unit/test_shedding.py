"""Overload in, work that is left out: in a stated order, never an observation, and all again after it."""

from itertools import chain, repeat
from types import SimpleNamespace

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.hypotheses.registry import Registry
from comotion.joints.joints import Joints
from comotion.linking.linker import Linker
from comotion.runtime.clocks import Overload
from comotion.runtime.loop import Loop
from comotion.shedding import MOST, Load
from comotion_experiments.offline import run_offline
from comotion_sources import simulator
from comotion_tools.bench import SceneSpec, messages

SECOND = 10**9
PERIOD = SECOND // 10
CROWD = SceneSpec(features=500, bodies=2, sources=1, rate=20.0, churn=0.1)


def shed(level, full=0, config=None):
    """A fusion that leaves out work after so many full updates."""
    fusion, levels = Fusion(config), chain(repeat(0, full), repeat(level))
    update = fusion.update
    fusion.update = lambda now_ns: update(now_ns, level=next(levels))
    return fusion


def simulated(name):
    return simulator.batches(simulator.simulate(simulator.load_scene(name), seed=1))


class TestObservations:
    @pytest.mark.parametrize(("method", "least"), [("comotion", 0.97), ("thesis", 0.7)])
    def test_of_a_large_space_some_are_grouped_and_new_ones_join_by_place_and_motion(self, method, least):
        fusion = shed(MOST, 31, FusionConfig(method=method, thesis={"sigma_switch": 0.02}))
        run = run_offline(messages(CROWD, 5.0), fusion)
        assert len(fusion.affinity("world").tracks) == 200
        assert run.nmi[30:].min() > least
        assert run.scores[-1].singletons == 0

    def test_at_the_highest_level_the_result_is_as_good_within_a_twentieth(self):
        fusions = [shed(level) for level in (0, MOST)]
        runs = [run_offline(simulated("3d_4"), fusion, duration=10.0) for fusion in fusions]
        means = [np.nanmean(run.nmi[run.seconds > 3.0]) for run in runs]
        assert means[0] > 0.9
        assert means[1] > means[0] - 0.05
        assert fusions[0].stats.fused == fusions[1].stats.fused
        assert runs[0].scores[-1].scored == runs[1].scores[-1].scored

    def test_a_body_that_comes_up_while_searches_are_rare_is_found(self):
        run = run_offline(simulated("fig4_3"), shed(4))
        assert [score.hypotheses for score in run.scores if score.stamp_ns < 10 * SECOND][-1] == 1
        assert run.scores[-1].hypotheses == 2


@pytest.mark.parametrize("level", range(4))
def test_the_first_levels_leave_out_joints_then_boxes_then_links(level, monkeypatch):
    options_of_work = {}

    def spied(plain):
        def call(*args, **options):
            options_of_work.update(options)
            return plain(*args, **options)

        return call

    for place, name in ((Joints, "update"), (Linker, "linked"), (Registry, "update")):
        monkeypatch.setattr(place, name, spied(getattr(place, name)))
    fusion = shed(level)
    run_offline(simulated("3d_2"), fusion, duration=0.2)
    assert options_of_work == {"judging": level < 1, "boxes": level < 2, "deciding": level < 3}
    assert fusion.stats.shed == (2 if level else 0)


def updates(load, took_s, start_s, count, *, busy=1.0):
    """Levels after updates of one kind, ten a second, that take `busy` times their processor time."""
    took_ns = round(took_s * SECOND)
    return [
        load.note(took_ns, round(took_ns / busy), round((start_s + 0.1 * k) * SECOND)) for k in range(count)
    ]


class TestLoad:
    def test_one_slow_update_is_enough_and_slower_ones_raise_it_more(self):
        assert updates(Load(PERIOD), 0.1, 0.0, 1) == [1]
        assert updates(Load(PERIOD), 0.4, 0.0, 1) == [5]
        assert updates(Load(PERIOD), 7.0, 0.0, 3) == [MOST, MOST, MOST]

    def test_after_a_pause_of_the_machine_all_is_done_again_within_a_second(self):
        load = Load(PERIOD)
        for start_s in range(0, 100, 2):
            assert updates(load, 3.0, start_s, 1, busy=100) == [MOST]
            levels = updates(load, 0.03, start_s + 0.1, 10)
            assert levels[3] == MOST
            assert levels[4:] == 6 * [0]

    def test_slow_updates_of_a_scene_find_their_level_and_stay_there(self):
        """Each level halves a cost of 0.3 s: the first that fits is kept but for a try now and then."""
        load, levels = Load(PERIOD), []
        for k in range(600):
            took = round(0.3 * SECOND / 2 ** (load.level / 2))
            levels.append(load.note(took, took, k * PERIOD))
        assert np.median(levels) == 4
        assert np.mean(np.array(levels[1:]) == 4) > 0.9


class TestOverload:
    def test_it_says_what_is_left_out_and_when_it_is_over(self, caplog):
        load = Overload(PERIOD)
        with caplog.at_level("INFO"):
            load.note(round(0.16 * SECOND), PERIOD // 10, 0)
            assert load.level == 2
            assert "left out are joints, axes of boxes" in load.notes()[0]
            load.note(SECOND // 100, SECOND // 100, SECOND)
        assert load.notes() == []
        assert "nothing is left out" in caplog.messages[-1]
        assert len(caplog.messages) == 2

    @pytest.mark.parametrize("shedding", [True, False])
    def test_switched_off_it_leaves_out_nothing(self, shedding):
        fusion = Fusion(FusionConfig(limits={"shedding": shedding}))
        loop = SimpleNamespace(_fusion=fusion, _overload=Overload(PERIOD))
        Loop._judge(loop, 3, 10 * PERIOD, PERIOD)
        assert (loop._overload.level, fusion.stats.overruns) == (8 if shedding else 0, 3)
