"""Playing streams, on a simulated clock."""

import threading

import numpy as np
import pytest

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_sources.frames import Frame, MessageBuilder
from comotion_sources.playback import StreamTape
from comotion_sources.player import Player, Schedule
from comotion_sources.streams import Stream

from ..simulated_clock import NOW, SimulatedClock


class RecordingSink:
    """Keeps what is put, and when."""

    def __init__(self, clock, name="s"):
        self.clock, self.name = clock, name
        self.sessions, self.overruns = 0, 0
        self.puts = []
        self.hold_up = {}
        self.new_session()

    def new_session(self):
        self.sessions += 1
        self.builder = MessageBuilder(
            source=self.name, session=f"{self.sessions:016x}", space="world", unit="m", dim=2
        )

    def put(self, message):
        self.puts.append((self.clock.wall(), message))
        self.clock.passed += self.hold_up.pop(len(self.puts), 0.0)

    def overrun(self):
        self.overruns += 1

    @property
    def batches(self):
        return [message for _, message in self.puts if isinstance(message, ObservationBatch)]

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


def stream(count=11, rate=10.0, length=1.0, **options):
    return Stream(
        name="s",
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
    streams = streams or [stream()]
    sinks = [RecordingSink(clock) for _ in streams]
    sinks[0].hold_up = hold_up or {}
    stop = threading.Event()
    told = []

    def progress(number, t):
        told.append((number, round(t, 6)))
        if told[-1] == stop_at:
            stop.set()

    when = Schedule(**schedule)
    tape = StreamTape(streams, sinks, live_stamps=when.live_stamps)
    Player(tape, when, stop, read_key=read_key, progress=progress, clock=clock).run()
    return sinks if len(sinks) > 1 else sinks[0]


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


def test_a_loop_is_a_new_session_with_stamps_that_go_on():
    sink = play(loop=True, stop_at=(2, 0.5))
    # The last instant of a pass is the first one of the next.
    assert sink.seconds() == tenths(0, 25)
    by_session = [(batch.session[-1], batch.seq) for batch in sink.batches]
    assert by_session == [("1", k) for k in range(10)] + [("2", k) for k in range(10)] + [
        ("3", k) for k in range(6)
    ]
    assert sum(isinstance(message, TruthBatch) for _, message in sink.puts) == 3


def test_original_stamps_go_on_over_passes_at_any_pace():
    sink = play(loop=True, live_stamps=False, pace=4.0, stop_at=(1, 0.3))
    assert sink.seconds(0.0) == tenths(0, 13)
    assert sink.clock.passed == pytest.approx(1.3 / 4)


def test_a_process_that_comes_later_joins_in_the_middle():
    sink = play(start_at=NOW - 0.55)
    assert sink.seconds()[0] == pytest.approx(-0.15)
    assert sink.seconds()[-1] == pytest.approx(0.45)
    assert [batch.seq for batch in sink.batches] == list(range(7))
    assert sink.overruns == 0


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


def test_a_pause_puts_frames_and_their_stamps_off():
    presses = iter([""] * 5 + [" ", "", " "])
    sink = play(read_key=lambda: next(presses, ""))
    times = sink.seconds()
    assert len(times) == 11
    assert max(np.diff(times)) == pytest.approx(0.3, abs=0.11)
    for wall, message in sink.puts:
        if isinstance(message, ObservationBatch):
            assert wall == pytest.approx(message.stamp_ns / 1e9, abs=1e-6)
    assert sink.overruns == 0


def test_several_streams_go_out_in_time_order():
    clock = SimulatedClock()
    streams = [stream(11, 10.0), stream(26, 25.0)]
    slow, fast = play(streams, clock=clock, loop=True, duration=1.95)
    assert len(slow.batches) == 20
    assert len(fast.batches) == 49
    assert slow.sessions == fast.sessions == 2
    merged = sorted([*slow.puts, *fast.puts], key=lambda put: put[0])
    stamps = [m.stamp_ns for _, m in merged if isinstance(m, ObservationBatch)]
    assert stamps == sorted(stamps)
