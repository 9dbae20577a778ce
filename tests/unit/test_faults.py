"""No input ends the core or stalls it: what was found once stays mended."""

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.runtime.log_limit import log_defect
from comotion_schemas import encode

from ..builders import MS, SESSION, T0, S, batch, play, settled

POINTS = np.random.default_rng(0).uniform(-1, 1, (12, 3))


def at(k):
    """Time of a frame, ns."""
    return T0 + round(k * S / 30)


def moved(k):
    """Half of the points rest, half move."""
    return POINTS + np.repeat([[0.0], [0.01 * k]], 6, axis=0)


def run(fusion, start, stop, *, source="cam", **fields):
    frames = range(start, stop)
    update = play(fusion, frames, lambda k, now: batch(source, k, now, moved(k), **fields))[-1]
    assert fusion.stats.batches == settled(fusion.stats)
    encode(update)
    return update


def test_the_same_ids_in_two_spaces_are_refused_in_the_second_one():
    fusion, pixels = Fusion(), {"space": "cam/pixels", "unit": "px"}
    update = play(
        fusion,
        range(20),
        lambda k, now: batch("cam", 2 * k, now, moved(k)),
        lambda k, now: batch("cam", 2 * k + 1, now, 100 * moved(k)[:, :2], **pixels),
    )[-1]
    assert len(update.track_id) == 12
    assert (fusion.stats.faults, fusion.stats.refused_rows) == (0, 20 * 12)


def test_stamps_at_the_ends_of_their_range_and_places_beyond_all_measure_are_refused():
    fusion = Fusion()
    fusion.timeline.replay()
    for seq, (stamp, scale) in enumerate(((-(2**63), 1), (2**63 - 1, 1), (T0, 1), (T0, 1e38))):
        fusion.ingest(batch("odd", seq, stamp, scale * POINTS))
        fusion.update(T0)
    assert fusion.stats.rejected == {"range": 3}
    assert run(fusion, 0, 5).track_id.size


def test_a_space_that_fails_is_built_anew_and_keeps_its_hypotheses(monkeypatch):
    fusion = Fusion()
    before = run(fusion, 0, 40)
    space = fusion._spaces["world"]
    monkeypatch.setattr(space._method, "partition", lambda *_: 1 / 0)
    after = run(fusion, 40, 60)
    assert {h.id for h in after.hypotheses} == {h.id for h in before.hypotheses}
    (fault,) = fusion.timeline.faults.take()
    assert "world" in fault.doing
    assert isinstance(fault.error, ZeroDivisionError)
    assert fusion.stats.faults == 1


def test_a_batch_that_fails_is_set_aside_and_no_id_is_used_again(monkeypatch, caplog):
    fusion = Fusion()
    before = run(fusion, 0, 20)
    window = fusion._spaces["world"]._window
    monkeypatch.setattr(window, "insert", lambda *_: 1 / 0)
    monkeypatch.setattr(window, "state", lambda: 1 / 0)
    after = run(fusion, 20, 60)
    assert fusion.stats.rejected == {"defect": 1}
    assert len(after.track_id) == 12
    assert min(h.id for h in after.hypotheses) > max(h.id for h in before.hypotheses)
    fault = fusion.timeline.faults.take()[0]
    for _ in range(2):
        log_defect(fault)
    assert "storing a batch: ZeroDivisionError; please report this (source cam, " in caplog.text
    assert caplog.text.count("Traceback") == 1


def test_ended_in_a_late_batch_ends_its_ids_and_an_ended_id_does_not_come_back():
    fusion = Fusion(FusionConfig(window=2.0))
    run(fusion, 0, 20)
    fusion.ingest(batch("cam", 20, T0, POINTS[:0], ended=np.array([3], np.uint64)))
    update = run(fusion, 21, 30)
    assert 3 not in update.track_id
    # Neither when its trajectory has left the window.
    assert 3 not in run(fusion, 200, 210).track_id
    assert fusion.stats.late == 1


@pytest.mark.parametrize("step_s", [-3600, 1])
def test_a_step_of_all_clocks_of_sources_loses_nothing_and_keeps_ids(step_s):
    """The clock of the service goes on: it is not set with them."""
    fusion = Fusion()

    def half(n, source):
        return lambda k, now: batch(source, k, now + (step_s * S if k >= 75 else 0) - 20 * MS, moved(k)[n::2])

    updates = play(fusion, range(150), half(0, "left"), half(1, "right"))
    before, update = {h.id for h in updates[70].hypotheses}, updates[-1]
    assert (fusion.stats.late, fusion.stats.lost, fusion.stats.rejected) == (0, 0, {})
    # A second ahead is taken for true: the data waits for it.
    assert abs(update.stamp_ns - (at(149) + step_s * S)) <= S
    assert {h.id for h in update.hypotheses} == before
    assert len(update.track_id) == 12


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_step_of_one_clock_harms_nobody_else_and_is_told(step_s):
    fusion = Fusion()
    update = play(
        fusion,
        range(90),
        lambda k, now: batch("right", k, now - 20 * MS, POINTS),
        lambda k, now: batch("wrong", k, now + (step_s * S if k >= 30 else 0) - 20 * MS, POINTS),
    )[-1]
    accounts = fusion.timeline.ledger.accounts
    assert accounts["right", SESSION].fused >= 89
    wrong = accounts["wrong", SESSION]
    assert wrong.late + wrong.rejected.get("future", 0) + wrong.waiting == 60
    assert "wrong" in fusion.timeline.troubles.lately()["clock-ahead" if step_s > 0 else "clock-behind"]
    assert abs(update.stamp_ns - at(89)) < S


def test_sources_that_are_all_ahead_are_followed_and_told_until_they_are_right():
    fusion = Fusion()
    for k in range(150):
        fusion.ingest(batch("ahead", k, at(k) + (5 * S if k < 90 else -20 * MS), moved(k)))
        update = fusion.update(at(k))
        if 30 <= k < 90:
            assert len(update.track_id) == 12
            assert "ahead" in fusion.timeline.troubles.lately()["clock-ahead"]
    assert len(update.track_id) == 12
    assert not fusion.timeline.troubles.sources("clock-ahead")


def test_sources_on_time_after_a_pause_are_not_ahead_though_the_scene_has_followed_late_ones():
    fusion, honest = Fusion(), ("left", "right")
    for k in range(240):
        now = at(k)
        for source in honest if not 60 <= k < 120 else ():
            fusion.ingest(batch(source, k, now - 20 * MS, POINTS))
        # Comes while the others pause, with what the clock has left behind by more than a second.
        if k >= 91:
            fusion.ingest(batch("late", k, now - 1_500 * MS, POINTS))
        update = fusion.update(now)
        assert not {"left", "right"} & fusion.timeline.troubles.lately().get("clock-ahead", {}).keys()
    accounts = fusion.timeline.ledger.accounts
    assert [accounts[name, SESSION].fused for name in honest] == [180, 180]
    assert "late" in fusion.timeline.troubles.lately()["clock-behind"]
    assert now - update.stamp_ns < 100 * MS


def test_a_scene_that_all_sources_have_left_does_not_look_alive():
    fusion = Fusion()
    update = run(fusion, 0, 60)
    assert any(h.state == "moving" for h in update.hypotheses)
    update = fusion.update(T0 + 30 * S)
    assert not update.live
    assert not any(h.state == "moving" or h.twist for h in update.hypotheses)
