"""What a crash or a bad disk has left of a recording, saved into a whole file.

The records are followed one by one. Where that fails, the next chunk is searched for: a chunk
tells its own length twice and carries a checksum, so that one is not mistaken for another thing.
"""

import mmap
import os
import struct
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC, Writer

from comotion_schemas.recording import PROFILE

from .disk import create

# Chunk record: opcode, length, two times, uncompressed size, CRC; then the compression's name.
_CHUNK = struct.Struct("<BQQQQI")
_FRAME = struct.Struct("<BQ")
_NAMES = (b"\x04\0\0\0zstd", b"\x03\0\0\0lz4", b"\0\0\0\0")
_LARGEST_CHUNK = 256 * 1024 * 1024
_DEFINITIONS: dict[int, type[Schema | Channel | Metadata]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}


@dataclass
class Repaired:
    """What was saved, and what could not be.

    `messages`, `chunks`: recovered; `damaged` chunks with a wrong checksum; `skipped` bytes that are
    no records, at the end of the file as a rule; `orphans`: messages of a channel whose definition
    is lost; `seconds` from the first to the last message.
    """

    messages: int = 0
    chunks: int = 0
    damaged: int = 0
    skipped: int = 0
    orphans: int = 0
    start_ns: int = 0
    end_ns: int = 0

    @property
    def seconds(self) -> float:
        """Time between the first message and the last."""
        return (self.end_ns - self.start_ns) / 1e9

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    def lines(self, target: Path) -> list[str]:
        """The result in words."""
        lines = [f"{target}: {self.messages} messages in {self.chunks} chunks, {self.seconds:.1f} s"]
        if self.damaged or self.skipped or self.orphans:
            lines.append(
                f"not recovered: {self.damaged} damaged records, {self.skipped} bytes that are no records, "
                f"{self.orphans} messages of unknown channels"
            )
        return lines

    def note(self, message: Message) -> None:
        """Count a message."""
        self.start_ns = min(self.start_ns, message.log_time) if self.messages else message.log_time
        self.end_ns = max(self.end_ns, message.log_time)
        self.messages += 1


def repair(source: Path, target: Path) -> Repaired:
    """Copy every readable message of a file into a new one with an index.

    Parameters
    ----------
    source
        The damaged file; it is not changed.
    target
        The new file; it must not exist.

    Raises
    ------
    ValueError
        If there is not one readable message.
    OSError
        If a file cannot be read or written, or `target` exists.
    """
    if source.stat().st_size == 0:
        raise ValueError(f"{source}: the file is empty")
    result = Repaired()
    with source.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        definitions = _Definitions()
        for record in _records(data, Repaired()):
            definitions.add(record)
        with os.fdopen(create(target), "wb") as output:
            try:
                _copy(data, definitions, Writer(output), result)
                if not result.messages:
                    raise ValueError(f"{source}: there is no readable message in it")
            except BaseException:
                target.unlink()
                raise
    return result


@dataclass
class _Definitions:
    """Schemas and channels from anywhere in the file, its end included."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, record: McapRecord) -> None:
        """Take note of a definition."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record


class _Renumbered:
    """Registers the old definitions with the writer as they are needed."""

    def __init__(self, definitions: _Definitions, writer: Writer) -> None:
        self._old, self._writer = definitions, writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def channel(self, number: int) -> int | None:
        """New number of an old channel; None if its definition is lost."""
        old = self._old.channels.get(number)
        if old is None:
            return None
        if number not in self._channels:
            self._channels[number] = self._writer.register_channel(
                topic=old.topic,
                message_encoding=old.message_encoding,
                schema_id=self._schema(old.schema_id),
                metadata=old.metadata,
            )
        return self._channels[number]

    def _schema(self, number: int) -> int:
        old = self._old.schemas.get(number)
        if old is None:
            return 0
        if number not in self._schemas:
            self._schemas[number] = self._writer.register_schema(old.name, old.encoding, old.data)
        return self._schemas[number]


def _copy(data: mmap.mmap, definitions: _Definitions, writer: Writer, result: Repaired) -> None:
    writer.start(profile=PROFILE)
    numbers = _Renumbered(definitions, writer)
    for record in _records(data, result):
        if isinstance(record, Metadata):
            writer.flush()
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Message):
            channel = numbers.channel(record.channel_id)
            if channel is None:
                result.orphans += 1
                continue
            result.note(record)
            writer.add_message(
                channel_id=channel,
                log_time=record.log_time,
                publish_time=record.publish_time,
                data=record.data,
                sequence=record.sequence,
            )
    writer.finish()


def _records(data: mmap.mmap, result: Repaired) -> Iterator[McapRecord]:
    """Messages, definitions and metadata of a file; what is damaged is counted and passed over."""
    position = len(MCAP0_MAGIC) if data[: len(MCAP0_MAGIC)] == MCAP0_MAGIC else 0
    while position < len(data) - len(MCAP0_MAGIC) or data[position:] not in {b"", MCAP0_MAGIC}:
        end = _end_of_record(data, position)
        if end is None:
            following = _next_chunk(data, position + 1)
            result.skipped += following - position
            position = following
            continue
        yield from _read(data[position:end], result)
        position = end


def _read(record: bytes, result: Repaired) -> Iterator[McapRecord]:
    opcode, content = record[0], record[_FRAME.size :]
    try:
        if opcode == Opcode.CHUNK:
            found = _break_up(content)
            result.chunks += 1
        elif opcode == Opcode.MESSAGE:
            found = [Message.read(ReadDataStream(BytesIO(content)), len(content))]
        elif opcode in _DEFINITIONS:
            found = [_DEFINITIONS[opcode].read(ReadDataStream(BytesIO(content)))]
        else:
            return
    except Exception:  # decompression and parsing of damaged bytes raise many types; all mean the same
        result.damaged += 1
        return
    yield from found


def _break_up(content: bytes) -> list[McapRecord]:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise ValueError("no recorder makes chunks of this size")
    return breakup_chunk(chunk, validate_crc=True)


def _end_of_record(data: mmap.mmap, position: int) -> int | None:
    """Where the record at a position ends; None if there is no whole record."""
    if position + _FRAME.size > len(data):
        return None
    opcode, length = _FRAME.unpack_from(data, position)
    end = position + _FRAME.size + length
    if not Opcode.HEADER <= opcode <= Opcode.DATA_END or end > len(data):
        return None
    if opcode == Opcode.CHUNK and not _agrees(data, position, length):
        return None
    if opcode == Opcode.MESSAGE_INDEX and not _is_index(data, position, length):
        return None
    return int(end)


def _is_index(data: mmap.mmap, position: int, length: int) -> bool:
    """An index tells its length twice as well: it must not leap over chunks."""
    if length < 6:
        return False
    (entries,) = struct.unpack_from("<I", data, position + _FRAME.size + 2)
    return bool(length == 6 + entries)


def _agrees(data: mmap.mmap, position: int, length: int) -> bool:
    """Whether the two lengths that a chunk tells agree."""
    name = position + _CHUNK.size
    for compression in _NAMES:
        if data[name : name + len(compression)] == compression:
            at = name + len(compression)
            (content,) = struct.unpack_from("<Q", data, at) if at + 8 <= len(data) else (-1,)
            return bool(at + 8 + content == position + _FRAME.size + length)
    return False


def _next_chunk(data: mmap.mmap, start: int) -> int:
    """Position of the next whole chunk; the end of the file if there is none."""
    at = start + _CHUNK.size
    while (at := data.find(_NAMES[0], at)) >= 0:
        position = at - _CHUNK.size
        if data[position] == Opcode.CHUNK and _end_of_record(data, position) is not None:
            return position
        at += 1
    return len(data)
