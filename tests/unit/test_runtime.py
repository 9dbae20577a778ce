"""The service's own parts: deadlines, clocks, health, state files. No process, no network."""

import os
import stat
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from comotion import Fusion, FusionConfig
from comotion.event_time.sources import Source
from comotion.event_time.stats import Stats
from comotion.event_time.timeline import Timeline
from comotion.runtime.clocks import EventClock, Ticker, WallClock
from comotion.runtime.health import Health
from comotion.runtime.state_file import (
    StateKeeper,
    begin_afresh,
    default_path,
    load_fusion,
    write_atomically,
    write_ids,
)
from comotion_schemas import ObservationBatch
from comotion_sources import simulator

from .. import builders

SECOND = 10**9
SESSION = "00000000000000aa"


class TestTicker:
    @pytest.mark.parametrize(("late", "skipped"), [(0, 0), (99, 0), (100, 1), (250, 2), (1000, 10)])
    def test_missed_deadlines_are_skipped_and_counted(self, late, skipped):
        ticker = Ticker(100, start_ns=0)
        assert ticker.advance(100 + late) == skipped
        # The next is ahead and on the grid: nothing is bunched.
        assert 0 < ticker.remaining_ns(100 + late) <= 100
        assert (100 + late + ticker.remaining_ns(100 + late)) % 100 == 0


class TestEventClock:
    def test_a_stamp_far_ahead_moves_nothing_while_others_keep_the_time(self):
        clock = EventClock()
        for k in range(30):
            clock.observe(k * SECOND // 10, k * SECOND // 10)
            clock.observe(10**6 * SECOND, k * SECOND // 10)
        assert clock.now_ns() == 29 * SECOND // 10

    def test_a_gap_that_all_share_is_crossed(self):
        clock = EventClock()
        clock.observe(SECOND, 0)
        clock.observe(60 * SECOND, SECOND)
        assert clock.now_ns() == SECOND
        clock.observe(60 * SECOND, SECOND + 1)
        assert clock.now_ns() == 60 * SECOND

    def test_a_step_of_the_wall_clock_is_known_but_not_followed(self, monkeypatch):
        clock = WallClock()
        wall, before = time.time_ns(), clock.now_ns()
        monkeypatch.setattr(time, "time_ns", lambda: wall + 3_600 * SECOND)
        assert 0 <= clock.now_ns() - before < 60 * SECOND
        assert abs(clock.set_by_ns() - 3_600 * SECOND) < 60 * SECOND

    def test_a_pause_of_the_process_between_two_looks_at_clocks_is_no_step(self, monkeypatch):
        monotonic, pauses = [0], [5 * SECOND]

        def read():
            wall = 1_000 * SECOND + monotonic[0]
            monotonic[0] += pauses.pop() if pauses else 0
            return wall

        monkeypatch.setattr(time, "monotonic_ns", lambda: monotonic[0])
        monkeypatch.setattr(time, "time_ns", read)
        clock = WallClock()
        assert (clock.now_ns(), clock.set_by_ns()) == (1_005 * SECOND, 0)


def batch(stamp_ns):
    return builders.batch("cam", 0, stamp_ns, np.zeros((2, 2)), session=SESSION, ids=[1, 2])


class TestHealth:
    def report(self, health, at_s, stats, sources=(), present=()):
        """`sources` maps names to the time in s since they were heard, which is the age of their stamps."""
        timeline, at_ns = Timeline(FusionConfig(), stats), int(at_s * SECOND)
        for name, age_s in dict(sources).items():
            heard_ns = at_ns - int(age_s * SECOND)
            timeline.sources[name] = Source(SESSION, heard_ns, heard_ns=heard_ns)
        tokens = SimpleNamespace(present=dict.fromkeys(present, 0))
        intake = SimpleNamespace(
            received=dict, rejection="", tokens=tokens, statuses=SimpleNamespace(refused=0)
        )
        clocks = SimpleNamespace(steps=0, offsets=dict)
        health.report(at_ns, at_ns, timeline, intake, clocks, [])
        return health.status()

    def test_silent_sources_degrade_and_when_all_are_silent_it_stalls(self):
        sources = {"a": 0.1, "b": 7.0}
        fields = self.report(Health(), 10, Stats(), sources, "abc")
        assert fields.state == "degraded"
        assert fields.message == "no data from b (7.0 s), c"
        assert fields.ages == sources
        assert {(p.source, p.kind) for p in fields.problems} == {("b", "silent"), ("c", "no-data")}
        assert self.report(Health(), 10, Stats(), {"b": 7.0}, "b").state == "stalled"

    def test_a_scene_that_all_sources_have_left_is_stalled(self):
        stats = Stats(batches=5, fused=5)
        fields = self.report(Health(), 1, stats, {"a": 30.0})
        assert fields.state == "stalled"
        assert "no source sends any more" in fields.message
        assert self.report(Health(), 1, stats).state == "stalled"

    @pytest.mark.parametrize("counter", ["lost", "late", "overruns"])
    def test_trouble_degrades_for_some_seconds(self, counter):
        health, stats = Health(), Stats()
        self.report(health, 0, stats)
        setattr(stats, counter, 3)
        assert self.report(health, 1, stats).state == "degraded"
        assert self.report(health, 2, stats).message == f"in the last 5 s 3 {counter}"
        for k in range(3, 8):
            fields = self.report(health, k, stats)
        assert fields.state == "ok"
        assert fields.counters[counter] == 3

    def test_a_report_is_passed_on_until_the_loop_hangs(self):
        health = Health()
        assert health.status().message == "preparing"
        report = self.report(health, 1, Stats(), {"a": 0.1})
        assert report.message == "1 live source"
        health.alive_ns = time.monotonic_ns()
        assert health.status() == report
        health.alive_ns = time.monotonic_ns() - 4 * SECOND
        assert health.status().state == "stalled"
        assert health.status().message == "no update for 4.0 s"


def kept(path, fusion, *, clean=False):
    """Write a state as the service does; returns the bytes."""
    state = fusion.capture(clean=clean)
    write_ids(path, fusion.next_id)
    write_atomically(path, state())
    return path.read_bytes()


def running(stamp_ns=SECOND, scene="default", first_id=1):
    fusion = Fusion(FusionConfig(), scene=scene, session="f" * 16, first_id=first_id)
    fusion.ingest(batch(stamp_ns))
    fusion.update(stamp_ns)
    return fusion


class TestStateFile:
    def load(self, path, scene="default", now_ns=None):
        return load_fusion(path, FusionConfig(), scene, SESSION, now_ns)

    def test_what_was_written_is_taken_up_under_a_new_session(self, tmp_path):
        fusion = running(scene="cell")
        before = fusion.update(SECOND)
        kept(tmp_path / "state", fusion, clean=True)
        again = self.load(tmp_path / "state", "cell")
        after = again.update(SECOND)
        assert (after.session, after.hypotheses) == (SESSION, before.hypotheses)
        assert after.track_id.tolist() == [1, 2]
        assert again.next_id == fusion.next_id
        assert {p.name for p in tmp_path.iterdir()} == {"state", "state.ids"}
        assert {stat.S_IMODE(p.stat().st_mode) for p in tmp_path.iterdir()} == {0o600}

    @pytest.mark.parametrize(
        "damage",
        [
            lambda data: b"",
            lambda data: b"\xff" * 100,
            lambda data: data[:-3],
            lambda data: data[: len(data) // 2] + b"?" + data[len(data) // 2 + 1 :],
            lambda data: b"COMOTION" + data[8:],
        ],
    )
    def test_a_bad_file_is_kept_aside_and_no_id_is_given_out_twice(self, tmp_path, damage, caplog):
        data = damage(kept(tmp_path / "state", running(first_id=5000)))
        (tmp_path / "state").write_bytes(data)
        assert self.load(tmp_path / "state").next_id > 5000
        assert (tmp_path / "state.rejected").read_bytes() == data
        assert "starting afresh" in caplog.text
        # The file has been put aside; the next start has the ids alone.
        assert self.load(tmp_path / "state").next_id > 5000

    @pytest.mark.parametrize("damage", [b"", b"comotion-ids 0\n", b"\xff" * 100])
    def test_damaged_ids_are_said_and_not_believed(self, tmp_path, damage, caplog):
        kept(tmp_path / "state", running(first_id=5000))
        (tmp_path / "state").unlink()
        assert self.load(tmp_path / "state").next_id > 5000
        (tmp_path / "state.ids").write_bytes(damage)
        assert self.load(tmp_path / "state").next_id < 5000
        assert "state.ids is damaged" in caplog.text

    def test_a_state_from_which_no_update_follows_is_refused(self, tmp_path, monkeypatch, caplog):
        kept(tmp_path / "state", running())
        monkeypatch.setattr(Fusion, "update", lambda fusion, now_ns: fusion.no_such_thing)
        assert self.load(tmp_path / "state").next_id > 1000
        assert "no update follows from it: AttributeError" in caplog.text

    def test_a_state_of_another_scene_is_refused(self, tmp_path, caplog):
        kept(tmp_path / "state", Fusion(scene="one"))
        assert self.load(tmp_path / "state", "two").update(SECOND).scene == "two"
        assert "'one', not 'two'" in caplog.text

    def test_a_state_from_the_future_is_refused_and_its_ids_are_not_reused(self, tmp_path, caplog):
        kept(tmp_path / "state", running(100 * SECOND, first_id=5000))
        again = self.load(tmp_path / "state", now_ns=90 * SECOND)
        assert again.timeline.watermark_ns is None
        assert again.next_id > 5000
        assert "10.0 s in the future" in caplog.text

    def test_a_new_scene_keeps_the_one_before_and_says_how_old_it_is(self, tmp_path, caplog):
        caplog.set_level("INFO")
        kept(tmp_path / "state", running(100 * SECOND, first_id=5000))
        os.utime(tmp_path / "state", (0, time.time() - 600))
        begin_afresh(tmp_path / "state")
        assert "a new scene; the one of 10 min ago is kept" in caplog.text
        assert self.load(tmp_path / "state.before", now_ns=200 * SECOND).next_id > 5000
        assert "continuing the scene of 10 min ago" in caplog.text
        assert not (tmp_path / "state").exists()
        begin_afresh(tmp_path / "state")

    def test_every_scene_of_every_network_has_a_file_of_its_own(self, tmp_path, monkeypatch):
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
        assert default_path("cell", ["tcp/127.0.0.1:7447"]) == tmp_path / "comotion" / "cell.state"
        assert default_path("cell", ["tcp/host:1"]).name == "cell@tcp-host-1.state"
        assert len(default_path("x" * 64, [f"tcp/host{k}:1" for k in range(50)]).name) < 240
        monkeypatch.setenv("XDG_STATE_HOME", "relative")
        assert default_path("cell", []) == Path.home() / ".local/state/comotion/cell.state"


class TestStateKeeper:
    def taken(self, keeper, hypotheses, now):
        """Whether the state is taken then."""
        before = keeper._newest
        keeper.after(frozenset(hypotheses), now)
        return keeper._newest is not before

    def test_it_is_due_at_an_interval_and_when_the_hypotheses_change(self, tmp_path):
        now = time.monotonic_ns()
        with StateKeeper(tmp_path / "state", 100 * SECOND, Fusion()) as keeper:
            assert self.taken(keeper, {1}, now)
            assert not self.taken(keeper, {1}, now + 99 * SECOND)
            assert self.taken(keeper, {1, 2}, now + 99 * SECOND)
            assert self.taken(keeper, {1, 2}, now + 199 * SECOND)

    def test_one_that_takes_long_to_write_is_written_less_often(self, tmp_path, monkeypatch):
        spent, now = iter((0, SECOND)), time.monotonic_ns()
        keeper, fusion = StateKeeper(tmp_path / "state", SECOND, Fusion()), Fusion()
        monkeypatch.setattr(time, "thread_time_ns", lambda: next(spent))
        keeper._write(1, fusion.capture())
        assert self.taken(keeper, {1}, now)
        assert not self.taken(keeper, {1, 2}, now + 9 * SECOND)
        assert self.taken(keeper, {1, 2}, now + 12 * SECOND)

    def test_a_captured_state_does_not_change_when_the_fusion_goes_on(self):
        fusion = Fusion(FusionConfig())
        spec = simulator.load_scene("3d_async")
        batches = (b for b in simulator.batches(simulator.simulate(spec)) if isinstance(b, ObservationBatch))
        captured = []
        for k, batch in zip(range(400), batches, strict=False):
            fusion.ingest(batch)
            if k % 40 == 39:
                fusion.update(batch.stamp_ns)
                captured.append((fusion.capture(), fusion.snapshot()))
        assert all(b"".join(state()) == data for state, data in captured)

    def test_the_last_state_is_written_before_the_end(self, tmp_path):
        fusion = Fusion()
        with StateKeeper(tmp_path / "state", 0, fusion) as keeper:
            for k in range(50):
                fusion.update(k * SECOND)
                keeper.after(frozenset({k}), time.monotonic_ns())
        assert (tmp_path / "state").read_bytes() == fusion.snapshot(clean=True)
        assert not any(thread.name == "state" for thread in threading.enumerate())

    def test_a_folder_that_cannot_be_written_is_told_once_and_survived(self, tmp_path, caplog):
        blocked = tmp_path / "blocked"
        blocked.write_text("a file, not a folder")
        with StateKeeper(blocked / "state", 0, Fusion()) as keeper:
            keeper.after(frozenset(), time.monotonic_ns())
        assert "state not written" in keeper.error
        assert caplog.text.count("cannot write the state") == 1

    def test_a_state_is_replaced_in_one_step(self, tmp_path, monkeypatch):
        write_atomically(tmp_path / "state", [b"o", b"ld"])

        def fail(descriptor):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="No space"):
            write_atomically(tmp_path / "state", [b"new"])
        assert (tmp_path / "state").read_bytes() == b"old"
        assert [p.name for p in tmp_path.iterdir()] == ["state"]
