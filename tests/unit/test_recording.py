"""Recordings: exact payloads in whole chunks, whatever the disk does; repair and export."""

import errno
import io
import json
import os
import struct
import subprocess
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader

from comotion import Fusion, FusionConfig
from comotion_clients.recording.file import StorageError
from comotion_clients.recording.process import PendingPayloads
from comotion_clients.recording.repair import repair
from comotion_clients.recording.series import Series, SeriesOptions
from comotion_schemas import Keys, TruthBatch, encode
from comotion_schemas.errors import RecordingError
from comotion_schemas.export import json_schemas
from comotion_schemas.message_log import Logged, MessageLog
from comotion_schemas.recording import MESSAGE_ENCODING
from comotion_sources.simulator import batches, load_scene, simulate

KEYS = Keys("lab")
SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND


def arrivals(seconds=3.0):
    """What a recorder of a three-source scene hears: truth, observations, updates, and nonsense."""
    simulation = simulate(load_scene("3d_async"))
    fusion = Fusion(FusionConfig(), scene="lab")
    due = BEGIN
    for message in batches(simulation, epoch_ns=BEGIN):
        if isinstance(message, TruthBatch):
            yield Logged("truth", KEYS.stream("truth", message.source), due, encode(message))
            continue
        if message.stamp_ns > BEGIN + seconds * SECOND:
            return
        fusion.ingest(message)
        now = message.stamp_ns + 5_000_000
        yield Logged("obs", KEYS.stream("obs", message.source), now, encode(message))
        if now >= due:
            due += SECOND // 2
            yield Logged("hypotheses", KEYS.hypotheses, now, encode(fusion.update(now)))
            yield Logged("obs", KEYS.stream("obs", "simulator-1"), now, b"nonsense")


SCENE = tuple(arrivals())


def read(path):
    """(topic, log time, payload) of a whole file, its checksums verified."""
    with path.open("rb") as file:
        messages = make_reader(file, validate_crcs=True).iter_messages()
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


def as_read(items):
    return [(a.key, a.log_ns, a.payload) for a in items]


def record(path, items=SCENE, flush_every=50, **options):
    series = Series(SeriesOptions(path=path, scene="lab", reserve_bytes=0, **options))
    for number, arrival in enumerate(items, 1):
        series.add(arrival)
        if number % flush_every == 0:
            series.flush()
    series.close({"lost": 0})
    return series


def test_payloads_come_back_byte_for_byte_with_both_times_and_the_schema(tmp_path):
    series = record(tmp_path / "take.mcap")
    assert sorted(read(series.path)) == sorted(as_read(SCENE))
    with series.path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages(KEYS.stream("obs", "simulator-3")):
            assert channel.message_encoding == "msgpack"
            assert json.loads(schema.data) == json_schemas()["ObservationBatch"]
            assert message.publish_time == message.log_time - 5_000_000
        assert reader.get_summary().statistics.message_count == len(SCENE)
        assert [m.name for m in reader.iter_metadata()] == ["comotion", "comotion.losses"]
    assert series.invalid == {"malformed": sum(a.payload == b"nonsense" for a in SCENE)}
    assert series.lost == {}


def test_an_existing_file_is_not_touched(tmp_path):
    path = tmp_path / "take.mcap"
    path.write_text("precious")
    with pytest.raises(OSError, match=r"exists: .*take\.mcap"):
        record(path)
    assert path.read_text() == "precious"


@pytest.mark.parametrize("options", [{"max_bytes": 20_000}, {"max_seconds": 1.0}], ids=str)
def test_every_file_of_a_rotation_is_whole(tmp_path, options):
    series = record(tmp_path / "take.mcap", **options)
    assert len(series.paths) > 2
    assert [p.name for p in series.paths[:2]] == ["take-001.mcap", "take-002.mcap"]
    contents = [read(path) for path in series.paths]
    earlier = []
    for content in contents:
        truth = [(key, data) for key, _, data in content if "/truth/" in key]
        assert set(earlier) <= set(truth)
        assert len(set(truth)) == len(truth)
        earlier = truth
        # The truth of before is stamped with the beginning of the file, not with its own past.
        times = [t for _, t, _ in content]
        assert times[-1] - times[0] < 2 * SECOND
    assert sorted(earlier) == sorted((a.key, a.payload) for a in SCENE if a.kind == "truth")
    others = sorted(item for content in contents for item in content if "/truth/" not in item[0])
    assert others == sorted(item for item in as_read(SCENE) if "/truth/" not in item[0])


class FullDisk(type(Path())):
    """A path on a disk that takes some bytes and then no more."""

    left, error = 0, errno.ENOSPC

    def open(self, mode):
        return io.BufferedWriter(FileOnFullDisk(self, mode))


class FileOnFullDisk(io.FileIO):
    def write(self, data):
        disk = type(self.name)
        taken = min(disk.left, len(data))
        if not taken and len(data):
            raise OSError(disk.error, os.strerror(disk.error))
        disk.left -= taken
        return super().write(data[:taken])


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO], ids=errno.errorcode.get)
def test_a_write_that_fails_leaves_whole_chunks_for_a_repair(tmp_path, monkeypatch, error):
    path = tmp_path / "take.mcap"
    monkeypatch.setattr(FullDisk, "left", 40_000)
    monkeypatch.setattr(FullDisk, "error", error)
    with pytest.raises(StorageError, match="no index: comotion record --repair") as raised:
        record(FullDisk(path))
    assert os.strerror(error) in str(raised.value)
    repaired = repair(path, tmp_path / "whole.mcap")
    assert (repaired.damaged, repaired.skipped) == (0, 0)
    content = read(tmp_path / "whole.mcap")
    assert len(content) == repaired.messages >= 100
    assert len(content) % 50 == 0
    assert Counter(content) == Counter(as_read(SCENE[: len(content)]))
    words = f"the {len(content)} messages written before are intact, 50 newer ones are lost"
    assert words in str(raised.value)


def test_recording_stops_before_the_reserve_is_touched(tmp_path, monkeypatch):
    free = [10_000_000]
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=free[0]))
    series = Series(SeriesOptions(path=tmp_path / "take.mcap", scene="lab", reserve_bytes=1_000_000))
    for arrival in SCENE[:100]:
        series.add(arrival)
    series.flush()
    for arrival in SCENE[100:120]:
        series.add(arrival)
    free[0] = 900_000
    with pytest.raises(StorageError, match=r"MiB free, .* are to stay free"):
        series.flush()
    series.abandon()
    assert Counter(read(series.path)) == Counter(as_read(SCENE[:120]))
    with pytest.raises(StorageError):
        Series(SeriesOptions(path=tmp_path / "other.mcap", reserve_bytes=1_000_000))
    assert not (tmp_path / "other.mcap").exists()


@pytest.mark.parametrize("what", ["content", "length"])
def test_repair_passes_over_a_damaged_chunk(tmp_path, what):
    path = record(tmp_path / "take.mcap").path
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[3]
    if what == "content":
        data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    else:
        struct.pack_into("<Q", data, chunk.chunk_start_offset + 1, 2**40)
    path.write_bytes(data)
    repaired = repair(path, tmp_path / "whole.mcap")
    assert repaired.messages == len(read(tmp_path / "whole.mcap")) == len(SCENE) - 50
    assert repaired.damaged + (repaired.skipped > 0) == 1


def test_what_waits_is_bounded_and_the_rest_is_counted():
    pending = PendingPayloads(limit=100)
    for number in range(5):
        pending.put(Logged("obs", KEYS.stream("obs", "a"), number, bytes(40)))
    assert [a.log_ns for a in pending.drain()] == [3, 4]
    assert pending.dropped_of == {KEYS.stream("obs", "a"): 3}
    small = Logged("obs", KEYS.stream("obs", "a"), 9, bytes(90))
    pending.put(small)
    assert pending.drain() == [small]
    assert pending.drain() == []


def test_the_export_is_what_foxglove_reads(tmp_path):
    export = pytest.importorskip("comotion_clients.foxglove.scene").export
    decoders = [pytest.importorskip("mcap_protobuf.decoder").DecoderFactory(), JsonDecoder()]
    path = record(tmp_path / "take.mcap").path
    exported = export(path, tmp_path / "fox.mcap", {1: "truck"})
    updates = sum(a.kind == "hypotheses" for a in SCENE)
    with (tmp_path / "fox.mcap").open("rb") as file:
        seen = Counter()
        reader = make_reader(file, validate_crcs=True, decoder_factories=decoders)
        for schema, channel, _, value in reader.iter_decoded_messages():
            seen[channel.topic] += 1
            if channel.topic == "/features/world" and seen[channel.topic] == updates - 1:
                assert schema.name == "foxglove.PointCloud"
                assert len(value.data) % value.point_stride == 0
            if channel.topic == "/labels/world":
                cubes = [cube for entity in value.entities for cube in entity.cubes]
                texts = [text.text for entity in value.entities for text in entity.texts]
            if channel.topic == "/numbers":
                numbers = value
    assert seen == exported.messages
    assert seen["/numbers"] == updates
    assert {"/features/world", "/hypotheses/world", "/labels/world", "/events"} <= set(seen)
    assert numbers["nmi"] is not None
    assert cubes
    assert all(0 < cube.size.x < 5 for cube in cubes)
    assert any(text.startswith("truck: ") for text in texts)
    assert exported.invalid == sum(a.payload == b"nonsense" for a in SCENE)


class JsonDecoder:
    """For channels of JSON."""

    def decoder_for(self, encoding, schema):
        return json.loads if encoding == "json" else None


def test_a_flood_of_keys_is_bounded_and_strange_names_are_no_sources(tmp_path, monkeypatch):
    monkeypatch.setattr("comotion_clients.recording.series.MAX_KEYS", 5)
    flood = [Logged("obs", f"{KEYS.prefix}/obs/Flood {n}", BEGIN, b"x") for n in range(10)]
    series = record(tmp_path / "take.mcap", [SCENE[0], *flood])
    assert series.invalid == {"malformed": 4, "limit": 6}
    assert len(read(series.path)) == 5
    with MessageLog(series.path) as log:
        assert log.sources == {"simulator-1": {"truth"}}
        assert [m.payload for m in log.messages()] == [SCENE[0].payload]


@pytest.mark.parametrize("command", [["record", "--repair"], ["source", "replay"]], ids=" ".join)
def test_without_the_extra_one_line_says_what_to_install(tmp_path, command):
    path = record(tmp_path / "take.mcap", SCENE[:50]).path
    script = (
        "import sys; sys.modules['mcap'] = None; from comotion_deploy.cli import run;"
        f"sys.exit(run({[*command, str(path)]!r}))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "error: mcap is not installed: pip install 'comotion[record]'\n"


def test_a_chunk_that_unpacks_to_gigabytes_is_refused_before_it_is_unpacked(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 30)
        writer.start()
        channel = writer.register_channel(KEYS.stream("obs", "cam"), MESSAGE_ENCODING, 0)
        writer.add_message(channel, 0, bytes(65 << 20), 0, 0)
        writer.finish()
    assert path.stat().st_size < 1 << 20
    with pytest.raises(RecordingError, match="damaged or never completed"):
        MessageLog(path)
