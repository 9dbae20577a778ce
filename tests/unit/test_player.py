"""Playing streams, on a simulated clock."""

import threading

import numpy as np
import pytest

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_sources import replay
from comotion_sources.frames import Frame
from comotion_sources.parts import Part, parse_part, parse_rates, rate_of
from comotion_sources.player import Player
from comotion_sources.streams import Stream, StreamLog
from comotion_sources.tape import Schedule, Tape, parse_start

from ..simulated_clock import NOW, SimulatedClock

SESSION = "5" * 16


class Outputs:
    """Keeps what is put, and when."""

    def __init__(self, clock):
        self.clock = clock
        self.overruns = 0
        self.puts = []
        self.hold_up = {}

    def put(self, kind, name, payload, message):
        self.puts.append((self.clock.wall(), message))
        self.clock.passed += self.hold_up.pop(len(self.puts), 0.0)

    def skipped(self, name):
        self.overruns += 1

    def of(self, name):
        return [b for b in self.batches if b.source == name]

    @property
    def batches(self):
        return [message for _, message in self.puts if isinstance(message, ObservationBatch)]

    @property
    def sessions(self):
        return len({message.session for _, message in self.puts})

    def seconds(self, origin=NOW):
        return [round(batch.stamp_ns / 1e9 - origin, 6) for batch in self.batches]


def frames(count, rate=10.0, ended=()):
    return [
        Frame(
            t=k / rate,
            ids=np.array([1], np.uint64),
            positions=np.array([[k, 0.0]]),
            objects=np.array([4], np.int32),
            ended=np.array([9] if k in ended else [], np.uint64),
        )
        for k in range(count)
    ]


def stream(count=11, rate=10.0, length=1.0, name="s", **options):
    return Stream(
        name=name,
        space="world",
        unit="m",
        dim=2,
        objects={4: "G"},
        rate=rate,
        length=length,
        frames=frames(count, rate, **options),
    )


def play(streams=None, *, clock=None, hold_up=None, stop_at=None, read_key=lambda: "", **schedule):
    clock = clock or SimulatedClock()
    outputs = Outputs(clock)
    outputs.hold_up = hold_up or {}
    stop = threading.Event()

    def progress(number, t):
        if (number, round(t, 6)) == stop_at:
            stop.set()

    when = Schedule(**schedule)
    tape = Tape(StreamLog(streams or [stream()], SESSION), outputs, when)
    Player(tape, when, stop, read_key=read_key, progress=progress, clock=clock).run()
    return outputs


def tenths(first, last):
    return [round(k / 10, 6) for k in range(first, last + 1)]


def test_each_frame_goes_out_when_it_is_due_with_that_stamp():
    sink = play()
    assert sink.seconds() == tenths(0, 10)
    for wall, message in sink.puts:
        if isinstance(message, ObservationBatch):
            assert wall == pytest.approx(message.stamp_ns / 1e9)
    assert [batch.seq for batch in sink.batches] == list(range(11))
    assert sink.sessions == 1


def test_the_truth_goes_out_once_and_first():
    sink = play()
    truths = [message for _, message in sink.puts if isinstance(message, TruthBatch)]
    assert [(t.ids.tolist(), t.objects.tolist(), t.names) for t in truths] == [([1], [4], {"4": "G"})]
    assert sink.puts[0][1] is truths[0]


def test_a_loop_is_a_new_session_with_stamps_that_go_on():
    sink = play(loop=True, stop_at=(2, 0.5))
    # The last instant of a pass is the first one of the next.
    assert sink.seconds() == tenths(0, 25)
    assert [batch.seq for batch in sink.batches] == [*range(10), *range(10), *range(6)]
    assert sink.sessions == 3
    assert sum(isinstance(message, TruthBatch) for _, message in sink.puts) == 3


def test_original_stamps_go_on_over_passes_at_any_pace():
    sink = play(loop=True, stamps="original", speed=4.0, stop_at=(1, 0.3))
    assert sink.seconds(0.0) == tenths(0, 13)
    assert sink.clock.passed == pytest.approx(1.3 / 4)
    assert sink.batches[0].session == SESSION
    assert sink.sessions == 2


def test_the_duration_ends_it():
    sink = play(loop=True, duration=1.55)
    assert sink.seconds() == tenths(0, 15)


def test_a_start_in_the_future_is_waited_for():
    assert play(start_at=NOW + 30).seconds() == [30 + t for t in tenths(0, 10)]


def test_a_process_that_comes_later_joins_in_the_middle():
    sink = play(start_at=NOW - 0.55)
    assert sink.seconds()[0] == pytest.approx(-0.15)
    assert sink.seconds()[-1] == pytest.approx(0.45)
    assert [batch.seq for batch in sink.batches] == list(range(7))
    assert sink.overruns == 0


def test_a_looping_process_that_comes_later_joins_the_pass_that_is_going_on():
    sink = play(start_at=NOW - 7.45, loop=True, stop_at=(8, 0.0))
    assert sink.seconds() == [round(t - 0.45, 6) for t in tenths(3, 9)]


def test_sources_that_start_aligned_are_in_phase():
    starts = set()
    for clock in (SimulatedClock(NOW + 0.27), SimulatedClock(NOW + 0.61)):
        sink = play(clock=clock, start_at="aligned", loop=True, stop_at=(1, 0.4))
        starts |= {batch.stamp_ns % 1_000_000_000 for batch in sink.batches}
    assert starts == {k * 100_000_000 for k in range(10)}
    waits = play(clock=SimulatedClock(NOW + 0.27), start_at="aligned")
    assert waits.seconds() == [1 + t for t in tenths(0, 10)]


def test_a_source_that_was_held_up_goes_on_with_fresh_instants():
    # The 4th put (truth and 3 batches before it) takes 0.45 s: what is then later than 0.2 s is left out.
    sink = play([stream(ended={4})], hold_up={4: 0.45})
    assert sink.seconds() == [0.0, 0.1, 0.2, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]
    assert sink.overruns == 2
    assert [batch.seq for batch in sink.batches] == list(range(9))
    # An end that fell into a left-out instant is still told.
    assert {k: b.ended.tolist() for k, b in enumerate(sink.batches) if b.ended is not None} == {3: [9]}


def test_a_step_of_the_wall_clock_does_not_stop_the_pacing():
    class Stepped(SimulatedClock):
        def wait(self, stop, seconds):
            if self.passed > 0.45:
                self.offset = NOW - 3600
            return super().wait(stop, seconds)

    clock = Stepped()
    sink = play(clock=clock)
    assert sink.seconds() == tenths(0, 10)
    assert clock.passed == pytest.approx(1.0)


def test_several_streams_go_out_in_time_order():
    clock = SimulatedClock()
    streams = [stream(11, 10.0, name="slow"), stream(26, 25.0, name="fast")]
    sink = play(streams, clock=clock, loop=True, duration=1.95)
    assert len(sink.of("slow")) == 20
    assert len(sink.of("fast")) == 49
    assert sink.sessions == 4
    assert sink.seconds() == sorted(sink.seconds())


def test_a_loop_over_a_stream_without_frames_takes_its_time():
    sink = play([stream(0)], loop=True, duration=5.5)
    assert sink.batches == []
    assert sink.clock.passed == pytest.approx(5.5)


@pytest.mark.parametrize(("text", "value"), [("now", "now"), ("aligned", "aligned"), ("12.5", 12.5)])
def test_starts_are_read(text, value):
    assert parse_start(text) == value


@pytest.mark.parametrize("text", ["", "soon", "-1", "nan", "inf", "1e10"])
def test_other_starts_are_refused(text):
    with pytest.raises(ValueError, match="neither 'now', 'aligned' nor"):
        parse_start(text)


def test_parts_and_rates_are_read():
    assert parse_part("2/3") == Part(1, 3)
    assert parse_rates("15, 30,100") == [15.0, 30.0, 100.0]
    assert rate_of(Part(1, 3), [10.0]) == 10.0
    assert rate_of(Part(1, 3), [10.0, 20.0, 30.0]) == 20.0


@pytest.mark.parametrize("text", ["", "2", "0/3", "4/3", "a/b", "1/0", "-1/3", "1/65", "1/2/3", "¹/²"])
def test_other_parts_are_refused(text):
    with pytest.raises(ValueError, match="is not K/N"):
        parse_part(text)


@pytest.mark.parametrize("text", ["", "0", "-5", "nan", "15,", "fast", "1e9"])
def test_other_rates_are_refused(text):
    with pytest.raises(ValueError, match="is not one or several numbers"):
        parse_rates(text)


def test_progress_is_plain_lines_away_from_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(replay, "_PLAIN_LINE_S", 0.0)
    with replay.shown_progress("take", 20.0) as advance:
        advance(0, 5.0)
        advance(2, 7.5)
    assert capsys.readouterr().err.splitlines() == ["take: 5.0 of 20.0 s", "take, pass 3: 7.5 of 20.0 s"]


def test_progress_is_a_bar_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(replay, "_TERMINAL_LINE_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    with replay.shown_progress("take", 20.0) as advance:
        advance(0, 10.0)
    shown = capsys.readouterr().err
    assert "━" * 20 in shown
    assert "━" * 21 not in shown
