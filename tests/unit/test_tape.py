"""Playing recorded scenes, on a simulated clock, and moving messages in time."""

import threading
from collections import defaultdict

import numpy as np
import pytest

from comotion_experiments.inputs import in_order_of_acquisition
from comotion_schemas import JointStates, Keys, TruthBatch, decode, encode
from comotion_schemas.message_log import Logged, MessageLog, logged_batches
from comotion_sources.errors import RecordingError
from comotion_sources.player import Player
from comotion_sources.tape import Restamp, Schedule, Tape

from .. import builders
from ..simulated_clock import NOW, SimulatedClock

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
LATENCY_NS = 20_000_000


def batch(source, seq, stamp_ns, **fields):
    return builders.batch(source, seq, stamp_ns, np.zeros((2, 3)), ids=[1, 2], **fields)


def logged(kind, name, log_ns, message):
    return Logged(
        kind, Keys().stream(kind, name), log_ns, message if isinstance(message, bytes) else encode(message)
    )


def scene(seconds=4, offset_ns=0):
    """Two sources at 10 and 5 Hz, the second with truth and one invalid payload."""
    items = [
        logged("truth", "b", BEGIN, TruthBatch(source="b", session="a" * 16, ids=[1], objects=[1], names={}))
    ]
    for tick in range(seconds * 10):
        stamp = BEGIN + tick * SECOND // 10
        items.append(logged("obs", "a", stamp + LATENCY_NS, batch("a", tick, stamp + offset_ns)))
        if tick % 2 == 0:
            items.append(logged("obs", "b", stamp + LATENCY_NS, batch("b", tick // 2, stamp + offset_ns)))
        if tick == 15:
            items.append(logged("obs", "b", stamp + LATENCY_NS, b"nonsense"))
    return items


class Log:
    gap_s = 0.1

    def __init__(self, items):
        self.items = items
        self.start_ns, self.end_ns = items[0].log_ns, items[-1].log_ns

    def messages(self, kinds=None, *, start_ns=None, end_ns=None):
        for item in self.items:
            if (kinds is None or item.kind in kinds) and (start_ns or 0) <= item.log_ns <= (end_ns or 2**63):
                yield item


class Wire:
    def __init__(self, clock):
        self.clock, self.puts, self.left_out, self.hold_up = clock, [], defaultdict(int), {}

    def put(self, kind, name, payload, message):
        self.puts.append((self.clock.passed, kind, name, payload))
        self.clock.passed += self.hold_up.pop(len(self.puts), 0.0)

    def skipped(self, name):
        self.left_out[name] += 1

    def batches(self, name):
        return [(at, decode(data)) for at, kind, who, data in self.puts if kind == "obs" and who == name]


def play(items, *, read_key=lambda: "", hold_up=None, **schedule):
    clock = SimulatedClock()
    wire = Wire(clock)
    wire.hold_up = hold_up or {}
    when = Schedule(**schedule)
    tape = Tape(Log(items), wire, when)
    Player(tape, when, threading.Event(), read_key=read_key, clock=clock).run()
    return wire


def test_original_payloads_go_out_byte_for_byte_when_they_came():
    items = scene()
    wire = play(items, stamps="original", speed=2.0)
    assert [(k, n, p) for _, k, n, p in wire.puts] == [(i.kind, i.name, i.payload) for i in items]
    for (at, *_), item in zip(wire.puts, items, strict=True):
        assert at == pytest.approx((item.log_ns - BEGIN) / 1e9 / 2, abs=1e-6)


@pytest.mark.parametrize("offset_ns", [0, -BEGIN], ids=["wall clock", "stamps from 0 on"])
@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_stamps_move_to_now_with_their_latency(speed, offset_ns):
    wire = play(scene(offset_ns=offset_ns), stamps="now", speed=speed)
    for name, count in (("a", 40), ("b", 20)):
        found = wire.batches(name)
        assert [b.seq for _, b in found] == list(range(count))
        assert len({b.session for _, b in found} - {"a" * 16}) == 1
        for at, b in found:
            age = (NOW + at) - b.stamp_ns / 1e9
            expected = LATENCY_NS / 1e9 / speed if offset_ns == 0 else 0.0
            assert age == pytest.approx(expected, abs=1e-6)
    assert wire.left_out == {"b": 1}
    truth = next(decode(data) for _, kind, _, data in wire.puts if kind == "truth")
    assert truth.session == wire.batches("b")[0][1].session


def test_a_part_comes_with_the_truth_of_before():
    wire = play(scene(), stamps="original", start=1.0, end=2.0)
    assert [kind for _, kind, _, _ in wire.puts].index("truth") == 0
    found = wire.batches("a")
    assert [b.seq for _, b in found] == list(range(10, 20))
    assert found[0][0] == pytest.approx(LATENCY_NS / 1e9, abs=1e-6)


def test_passes_follow_each_other_as_new_sessions():
    wire = play(scene(seconds=2), stamps="original", loop=True, duration=5.0)
    found = [b for _, b in wire.batches("a")]
    assert len(found) > 40
    stamps = [b.stamp_ns for b in found]
    assert stamps == sorted(set(stamps))
    sessions = [b.session for b in found]
    assert sessions[:20] == ["a" * 16] * 20
    assert len(set(sessions[20:40])) == 1
    assert "a" * 16 not in sessions[20:]
    assert [b.seq for b in found[20:40]] == list(range(20))


@pytest.mark.parametrize("stamps", ["now", "original"])
def test_a_pause_puts_everything_off(stamps):
    presses = iter([""] * 20 + [" "] + [""] * 30 + [" "])
    wire = play(scene(), stamps=stamps, read_key=lambda: next(presses, ""))
    times = [at for at, _ in wire.batches("a")]
    gaps = np.diff(times)
    assert len(times) == 40
    assert max(gaps) == pytest.approx(3.2, abs=0.15)
    assert sorted(gaps)[-2] == pytest.approx(0.1, abs=1e-6)
    if stamps == "now":
        for at, b in wire.batches("a"):
            assert (NOW + at) - b.stamp_ns / 1e9 == pytest.approx(0.02, abs=0.001)


def test_what_is_late_is_left_out_live_and_kept_in_the_original():
    assert len(play(scene(), stamps="original", hold_up={10: 1.0}).batches("a")) == 40
    wire = play(scene(), stamps="now", hold_up={10: 1.0})
    assert len(wire.batches("a")) == pytest.approx(32, abs=2)
    assert wire.left_out["a"] == 40 - len(wire.batches("a"))
    # What is left out on purpose is no loss.
    assert [b.seq for _, b in wire.batches("a")] == list(range(len(wire.batches("a"))))


@pytest.mark.parametrize(
    "schedule", [{"speed": 0.0}, {"speed": 1001.0}, {"start": 2.0, "end": 1.0}, {"start": -1.0}], ids=str
)
def test_a_schedule_that_makes_no_sense_is_refused(schedule):
    with pytest.raises(ValueError, match=r"speed|the end of what"):
        Schedule(**schedule)


def test_a_start_behind_the_end_is_refused():
    with pytest.raises(ValueError, match=r"is only .* s long"):
        play(scene(), start=100.0)


def test_every_stamp_of_a_batch_moves():
    stamps = np.array([BEGIN, BEGIN + SECOND], np.int64)
    moved = Restamp(BEGIN, 7 * SECOND, 2.0)(batch("a", 0, BEGIN + SECOND, stamps_ns=stamps))
    assert moved.stamps_ns.tolist() == [7 * SECOND, 7 * SECOND + SECOND // 2]
    assert moved.stamp_ns == 7 * SECOND + SECOND // 2
    joints = JointStates(
        source="a", session="a" * 16, seq=0, stamp_ns=BEGIN, names=["j"], positions=np.zeros(1)
    )
    assert Restamp(BEGIN, 5, 1.0)(joints).stamp_ns == 5


def test_a_recording_that_breaks_off_names_the_repair(tmp_path):
    from comotion_clients.recording.file import RecordingFile

    path = tmp_path / "take.mcap"
    with RecordingFile(path, scene="default") as file:
        for item in scene():
            file.add(item.key, item.log_ns, item.payload, item.decode())
    with MessageLog(path) as log:
        assert log.sources == ["a", "b"]
        assert [m.payload for m in log.messages()] == [i.payload for i in scene()]
    assert len(list(logged_batches(path))) == len(scene()) - 1
    data = bytearray(path.read_bytes())
    data[len(data) // 8] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="comotion record --repair"):
        list(logged_batches(path))


def test_the_order_of_acquisition_does_not_depend_on_that_of_receipt():
    rng = np.random.default_rng(3)
    items = [(i.log_ns, i.decode()) for i in scene(seconds=30) if i.decode() is not None]
    orders = []
    for _ in range(2):
        held_up = sorted(((t + int(rng.integers(0, 2 * SECOND)), m) for t, m in items), key=lambda x: x[0])
        orders.append([m.stamp_ns for _, m in in_order_of_acquisition(held_up) if hasattr(m, "seq")])
    assert orders[0] == orders[1] == sorted(orders[0])
    assert len(orders[0]) == len(items) - 1


def test_a_stamp_from_another_time_holds_nothing_up():
    wrong = (BEGIN + SECOND, batch("wrong", 0, BEGIN + 10**15))
    items = [(i.log_ns, i.decode()) for i in scene(seconds=30) if i.decode() is not None]
    found = list(in_order_of_acquisition([*items[:15], wrong, *items[15:]]))
    assert found[-1] == wrong
    assert len(found) == len(items) + 1
