"""Repairs a damaged recording: copies all readable messages to a complete file.

Records are read one by one by the MCAP library. After a damaged record the next chunk is searched: a chunk
contains its length twice and a checksum, so other bytes are not mistaken for a chunk.
"""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from comotion_schemas.errors import KnownError
from comotion_schemas.recording import PROFILE
from comotion_schemas.text import counted

from .file import Definition, TopicWriter

_COMPRESSED = b"\x04\0\0\0zstd"
_BEFORE_COMPRESSION = struct.calcsize("<BQQQQI")  # opcode, length, start and end time, size and checksum
_MAX_CHUNK_BYTES = 256 * 1024 * 1024  # of damaged lengths; chunks of the recorder have about 1 MiB


@dataclass
class RepairResult:
    """Result of a repair.

    `messages`, `chunks`: recovered; `damaged`: records with a wrong checksum or content; `skipped`:
    bytes that are not records, usually at the end of the file; `orphans`: messages of a channel whose
    definition is lost; `start_ns`, `end_ns`: log times of the first and the last message.
    """

    messages: int = 0
    chunks: int = 0
    damaged: int = 0
    skipped: int = 0
    orphans: int = 0
    start_ns: int = 0
    end_ns: int = 0

    def lines(self, target: Path) -> list[str]:
        """Format the result as text."""
        held = f"{counted(self.messages, 'message')} in {counted(self.chunks, 'chunk')}"
        lines = [f"{target}: {held}, {(self.end_ns - self.start_ns) / 1e9:.1f} s"]
        if self.damaged or self.skipped or self.orphans:
            lines.append(
                f"not recovered: {counted(self.damaged, 'damaged record')}, "
                f"{self.skipped} bytes that are no record, "
                f"{counted(self.orphans, 'message')} of unknown channels"
            )
        return lines


def repair(source: Path, target: Path) -> RepairResult:
    """Copy every readable message of a file to a new file with an index.

    The damaged `source` is not changed; the `target` must not exist.

    Raises
    ------
    ValueError
        If there is no readable message.
    OSError
        If a file cannot be read or written, or `target` exists.
    """
    if source.stat().st_size == 0:
        raise KnownError(f"{source}: the file is empty")
    result = RepairResult()
    with (
        source.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
        target.open("xb") as output,
    ):
        try:
            _copy(data, TopicWriter(output, profile=PROFILE), result)
            if not result.messages:
                raise KnownError(f"{source}: there is no readable message in it")
        except BaseException:
            target.unlink()
            raise
    return result


def _copy(data: mmap.mmap, writer: TopicWriter, result: RepairResult) -> None:
    """Write the messages and metadata of a file, chunk by chunk."""
    schemas: dict[int, Definition] = {}
    channels: dict[int, Channel] = {}
    # The end of a file repeats the definitions: they may be lost where they are used.
    for record in (member for group in _groups(data, RepairResult()) for member in group):
        if isinstance(record, Schema):
            schemas[record.id] = Definition(record.name, record.encoding, record.data)
        elif isinstance(record, Channel):
            channels[record.id] = record
    for group in _groups(data, result):
        for record in group:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, record.metadata)
            elif isinstance(record, Message) and record.channel_id in channels:
                channel, log_ns = channels[record.channel_id], record.log_time
                result.start_ns = min(result.start_ns, log_ns) if result.messages else log_ns
                result.end_ns = max(result.end_ns, log_ns)
                result.messages += 1
                schema = schemas.get(channel.schema_id)
                number = writer.channel(channel.topic, schema, channel.message_encoding)
                writer.add_message(number, log_ns, record.data, record.publish_time, record.sequence)
            else:
                result.orphans += isinstance(record, Message)
        writer.flush()
    writer.finish()


def _groups(data: mmap.mmap, result: RepairResult) -> Iterator[list[McapRecord]]:
    """Yield the records of a file, those of a chunk together; count and skip damaged parts."""
    position = len(MCAP0_MAGIC)
    end = len(data) - len(MCAP0_MAGIC) if data[-len(MCAP0_MAGIC) :] == MCAP0_MAGIC else len(data)
    while position < end:
        record, following = _record(data, position)
        if record is None:
            following = _next_chunk(data, position + 1)
            result.skipped += following - position
        elif isinstance(record, Chunk):
            try:
                if record.uncompressed_size > _MAX_CHUNK_BYTES:
                    raise KnownError("the size of the chunk is not plausible")
                records = breakup_chunk(record, validate_crc=True)
            except Exception:  # decompression and parsing raise many types on damaged bytes
                result.damaged += 1
            else:
                result.chunks += 1
                yield records
        else:
            yield [record]
        position = following


def _record(data: mmap.mmap, position: int) -> tuple[McapRecord | None, int]:
    """Return the record at a position and where it ends; None if there is no whole record."""
    data.seek(position)
    limit = len(data) - position
    reader = StreamReader(data, skip_magic=True, emit_chunks=True, record_size_limit=limit)  # type: ignore[arg-type]
    try:
        record = next(reader.records)
    except (McapError, struct.error, ValueError, StopIteration):
        return None, position
    builder = RecordBuilder()
    record.write(builder)
    # A record whose length does not agree with its content would hide those that follow.
    whole = builder.count == data.tell() - position
    return (record if whole else None), data.tell()


def _next_chunk(data: mmap.mmap, start: int) -> int:
    """Return the position of the next whole chunk, or the end of the file."""
    at = start + _BEFORE_COMPRESSION
    while (at := data.find(_COMPRESSED, at)) >= 0:
        position = at - _BEFORE_COMPRESSION
        if data[position] == Opcode.CHUNK and _record(data, position)[0] is not None:
            return position
        at += 1
    return len(data)
