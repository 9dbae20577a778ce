"""Playing streams and recorded scenes, on a simulated clock, and moving messages in time."""

import threading
from collections import defaultdict
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from comotion_experiments.inputs import in_order_of_acquisition
from comotion_schemas import JointStates, Keys, ObservationBatch, TruthBatch, encode
from comotion_schemas.message_log import Logged
from comotion_sources.player import Player
from comotion_sources.schedule import Restamp, Schedule
from comotion_sources.streams import Frame, Stream, StreamLog

from .. import builders
from ..builders import SESSION, S

NOW = 1_000_000.0
BEGIN = 1_700_000_000 * S
LATENCY_NS = 20_000_000


class SimulatedClock(threading.Event):
    """A clock and what ends playback: waiting for it takes no time; the wall clock may be stepped."""

    def __init__(self, wall=NOW):
        super().__init__()
        self.passed, self.offset = 0.0, wall

    def time(self):
        return self.offset + self.passed

    def monotonic(self):
        return 5.0 + self.passed

    def wait(self, seconds):
        self.passed += 0.0 if self.is_set() else seconds
        return self.is_set()


class Outputs:
    """Keeps what is put, and when."""

    def __init__(self, clock, hold_up):
        self.clock, self.hold_up = clock, dict(hold_up or {})
        self.left_out = defaultdict(int)
        self.puts = []

    def __getitem__(self, name):
        return SimpleNamespace(send=partial(self.put, name), count=partial(self.skipped, name))

    def put(self, name, kind, payload, message):
        self.puts.append((self.clock.passed, kind, name, payload, message))
        self.clock.passed += self.hold_up.pop(len(self.puts), 0.0)

    def skipped(self, name, _counter):
        self.left_out[name] += 1

    def of(self, kind, *names):
        """(seconds passed, message) of messages of a type, of all sources or those named."""
        return [
            (at, message)
            for at, _, name, _, message in self.puts
            if isinstance(message, kind) and (not names or name in names)
        ]

    def batches(self, *names):
        return [batch for _, batch in self.of(ObservationBatch, *names)]

    @property
    def sessions(self):
        return len({message.session for *_, message in self.puts})

    def seconds(self, origin=NOW):
        return [round(batch.stamp_ns / 1e9 - origin, 6) for batch in self.batches()]


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


class Frames(Stream):
    space, unit, dim, objects, length, passes = "world", "m", 2, {4: "G"}, 1.0, 0

    def __init__(self, name, rate, frames):
        self.name, self.rate, self.frames = name, rate, frames

    def __iter__(self):
        self.passes += 1
        return iter(self.frames)


def stream(count=11, rate=10.0, name="s", **options):
    return Frames(name, rate, frames(count, rate, **options))


def batch(source, seq, stamp_ns, **fields):
    return builders.batch(source, seq, stamp_ns, np.zeros((2, 3)), ids=[1, 2], **fields)


def logged(kind, name, log_ns, message):
    payload = message if isinstance(message, bytes) else encode(message)
    return Logged(kind, Keys().stream(kind, name), log_ns, payload)


def scene(seconds=4, offset_ns=0):
    """Two recorded sources at 10 and 5 Hz, the second with truth and one invalid payload."""
    items = [
        logged("truth", "b", BEGIN, TruthBatch(source="b", session=SESSION, ids=[1], objects=[1], names={}))
    ]
    for tick in range(seconds * 10):
        stamp = BEGIN + tick * S // 10
        items.append(logged("obs", "a", stamp + LATENCY_NS, batch("a", tick, stamp + offset_ns)))
        if tick % 2 == 0:
            items.append(logged("obs", "b", stamp + LATENCY_NS, batch("b", tick // 2, stamp + offset_ns)))
        if tick == 15:
            items.append(logged("obs", "b", stamp + LATENCY_NS, b"nonsense"))
    return items


class Log:
    """A recording in memory."""

    gap_s = 0.1

    def __init__(self, items):
        self.items = items
        self.start_ns, self.end_ns = items[0].log_ns, items[-1].log_ns

    def messages(self, kinds=None, *, start_ns=None, end_ns=None):
        for item in self.items:
            if (kinds is None or item.kind in kinds) and (start_ns or 0) <= item.log_ns <= (end_ns or 2**63):
                yield item


def play(*streams, log=None, clock=None, hold_up=None, stop_at=None, read_key=lambda: "", **schedule):
    """Play streams, one by default, or a log."""
    clock = clock or SimulatedClock()
    outputs, when = Outputs(clock, hold_up), Schedule(**schedule)

    def progress(number, t):
        if (number, round(t, 6)) == stop_at:
            clock.set()

    given = log or StreamLog(list(streams) or [stream()], SESSION)
    Player(given, outputs, when, clock, read_key=read_key, progress=progress, clock=clock).run()
    return outputs


def tenths(first, last):
    return [round(k / 10, 6) for k in range(first, last + 1)]


def test_each_frame_goes_out_when_it_is_due_with_that_stamp_after_the_truth():
    sink = play()
    assert sink.seconds() == tenths(0, 10)
    for passed, message in sink.of(ObservationBatch):
        assert NOW + passed == pytest.approx(message.stamp_ns / 1e9)
    assert [batch.seq for batch in sink.batches()] == list(range(11))
    ((_, truth),) = sink.of(TruthBatch)
    assert (truth.ids.tolist(), truth.objects.tolist(), truth.names) == ([1], [4], {"4": "G"})
    assert (sink.puts[0][-1], sink.sessions) == (truth, 1)


def test_a_loop_is_a_new_session_with_stamps_that_go_on_until_its_duration_is_over():
    sink = play(loop=True, duration=2.55)
    # The last instant of a pass is the first one of the next.
    assert sink.seconds() == tenths(0, 25)
    assert [batch.seq for batch in sink.batches()] == [*range(10), *range(10), *range(6)]
    assert (sink.sessions, len(sink.of(TruthBatch))) == (3, 3)


ALIGNED = {"start_at": "aligned", "loop": True, "stop_at": (1, 0.4)}
STARTS = {
    "in the future, which is waited for": ({"start_at": NOW + 30}, [30 + t for t in tenths(0, 10)]),
    "before, in the middle": ({"start_at": NOW - 0.55}, [t - 0.55 for t in tenths(4, 10)]),
    "before, in the pass that is going on": (
        {"start_at": NOW - 7.45, "loop": True, "stop_at": (8, 0.0)},
        [t - 0.45 for t in tenths(3, 9)],
    ),
    "aligned": ({"start_at": "aligned", "wall": NOW + 0.27}, [1 + t for t in tenths(0, 10)]),
    "aligned, in a loop": (ALIGNED | {"wall": NOW + 0.27}, tenths(1, 14)),
    "aligned, of another process": (ALIGNED | {"wall": NOW + 0.61}, tenths(5, 14)),
}


@pytest.mark.parametrize(("how", "seconds"), STARTS.values(), ids=STARTS)
def test_a_start(how, seconds):
    schedule = dict(how)
    sink = play(clock=SimulatedClock(schedule.pop("wall", NOW)), **schedule)
    assert sink.seconds() == pytest.approx(seconds)
    assert [batch.seq for batch in sink.batches()][:5] == list(range(5))
    assert sink.left_out == {}


def test_a_source_that_was_held_up_goes_on_with_fresh_instants():
    # The 4th put (truth and 3 batches before it) takes 0.45 s: what is then later than 0.2 s is left out.
    sink = play(stream(ended={4}), hold_up={4: 0.45})
    assert (sink.seconds(), sink.left_out) == ([0.0, 0.1, 0.2, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0], {"s": 2})
    # What is left out on purpose is no loss.
    assert [batch.seq for batch in sink.batches()] == list(range(9))
    # An end that fell into a left-out instant is still told.
    assert {k: b.ended.tolist() for k, b in enumerate(sink.batches()) if b.ended is not None} == {3: [9]}
    assert play(hold_up={4: 0.45}, stamps="original").seconds(0.0) == tenths(0, 10)
    # After a sleep it goes on where it was; in phase with others, passes that are over are not caught up.
    assert play(hold_up={4: 58.45}, duration=59).seconds()[3:] == [58.65, 58.75, 58.85, 58.95]
    play(phased := stream(), loop=True, duration=59.05, start_at=NOW, hold_up={4: 58.45})
    assert phased.passes < 10


def test_a_step_of_the_wall_clock_does_not_stop_the_pacing():
    class Stepped(SimulatedClock):
        def wait(self, seconds):
            if self.passed > 0.45:
                self.offset = NOW - 3600
            return super().wait(seconds)

    assert play(clock=(clock := Stepped())).seconds() == tenths(0, 10)
    assert clock.passed == pytest.approx(1.0)


def test_several_streams_go_out_in_time_order_and_one_without_frames_takes_its_time():
    sink = play(stream(11, 10.0, name="slow"), stream(26, 25.0, name="fast"), loop=True, duration=1.95)
    assert (len(sink.batches("slow")), len(sink.batches("fast")), sink.sessions) == (20, 49, 4)
    assert sink.seconds() == sorted(sink.seconds())
    sink = play(stream(0), loop=True, duration=5.5)
    assert sink.batches() == []
    assert sink.clock.passed == pytest.approx(5.5)


def test_original_payloads_go_out_byte_for_byte_when_they_came():
    items = scene()
    wire = play(log=Log(items), stamps="original", speed=2.0)
    assert [(k, n, p) for _, k, n, p, _ in wire.puts] == [(i.kind, i.name, i.payload) for i in items]
    for (at, *_), item in zip(wire.puts, items, strict=True):
        assert at == pytest.approx((item.log_ns - BEGIN) / 1e9 / 2, abs=1e-6)


@pytest.mark.parametrize("offset_ns", [0, -BEGIN], ids=["wall clock", "stamps from 0 on"])
@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_stamps_move_to_now_with_their_latency(speed, offset_ns):
    wire = play(log=Log(scene(offset_ns=offset_ns)), stamps="now", speed=speed)
    for name, count in (("a", 40), ("b", 20)):
        played = wire.of(ObservationBatch, name)
        assert [b.seq for _, b in played] == list(range(count))
        assert len({b.session for _, b in played} - {SESSION}) == 1
        for at, b in played:
            age = (NOW + at) - b.stamp_ns / 1e9
            expected = LATENCY_NS / 1e9 / speed if offset_ns == 0 else 0.0
            assert age == pytest.approx(expected, abs=1e-6)
    assert wire.left_out == {"b": 1}
    assert wire.of(TruthBatch)[0][1].session == wire.batches("b")[0].session


def test_a_part_comes_with_the_truth_of_before():
    wire = play(log=Log(scene()), stamps="original", start=1.0, end=2.0)
    assert wire.puts[0][1] == "truth"
    played = wire.of(ObservationBatch, "a")
    assert [b.seq for _, b in played] == list(range(10, 20))
    assert played[0][0] == pytest.approx(LATENCY_NS / 1e9, abs=1e-6)


@pytest.mark.parametrize("stamps", ["now", "original"])
def test_a_pause_puts_everything_off(stamps):
    presses = iter([""] * 20 + [" "] + [""] * 30 + [" "])
    wire = play(log=Log(scene()), stamps=stamps, read_key=lambda: next(presses, ""))
    times = [at for at, _ in wire.of(ObservationBatch, "a")]
    gaps = np.diff(times)
    assert len(times) == 40
    assert max(gaps) == pytest.approx(3.2, abs=0.15)
    assert sorted(gaps)[-2] == pytest.approx(0.1, abs=1e-6)
    if stamps == "now":
        for at, b in wire.of(ObservationBatch, "a"):
            assert (NOW + at) - b.stamp_ns / 1e9 == pytest.approx(0.02, abs=0.001)


def test_every_stamp_of_a_batch_moves():
    stamps = np.array([BEGIN, BEGIN + S], np.int64)
    moved = Restamp(BEGIN, 7 * S, 2.0)(batch("a", 0, BEGIN + S, stamps_ns=stamps))
    assert moved.stamps_ns.tolist() == [7 * S, 7 * S + S // 2]
    assert moved.stamp_ns == 7 * S + S // 2
    joints = JointStates(
        source="a", session=SESSION, seq=0, stamp_ns=BEGIN, names=["j"], positions=np.zeros(1)
    )
    assert Restamp(BEGIN, 5, 1.0)(joints).stamp_ns == 5


def test_the_order_of_acquisition_does_not_depend_on_that_of_receipt():
    rng = np.random.default_rng(3)
    items = [(i.log_ns, i.decode()) for i in scene(seconds=30) if i.decode() is not None]
    orders = []
    for _ in range(2):
        held_up = sorted(((t + int(rng.integers(0, 2 * S)), m) for t, m in items), key=lambda x: x[0])
        orders.append([m.stamp_ns for _, m in in_order_of_acquisition(held_up) if hasattr(m, "seq")])
    assert orders[0] == orders[1] == sorted(orders[0])
    assert len(orders[0]) == len(items) - 1


def test_a_stamp_from_another_time_holds_nothing_up():
    wrong = (BEGIN + S, batch("wrong", 0, BEGIN + 10**15))
    items = [(i.log_ns, i.decode()) for i in scene(seconds=30) if i.decode() is not None]
    played = list(in_order_of_acquisition([*items[:15], wrong, *items[15:]]))
    assert played[-1] == wrong
    assert len(played) == len(items) + 1
