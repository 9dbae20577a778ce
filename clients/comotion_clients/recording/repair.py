"""Repair: damaged recording -> complete file with all readable messages.

Records are read one by one. After a damaged record the next chunk is searched: a chunk contains its
length twice and a checksum, so other bytes are not mistaken for a chunk.
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

from comotion_schemas.errors import KnownError
from comotion_schemas.recording import PROFILE

from .disk import create

# Chunk record: opcode, length, start and end time, uncompressed size, CRC; then the compression name.
_CHUNK = struct.Struct("<BQQQQI")
_FRAME = struct.Struct("<BQ")
_NAMES = (b"\x04\0\0\0zstd", b"\x03\0\0\0lz4", b"\0\0\0\0")
_MAX_CHUNK_BYTES = 256 * 1024 * 1024  # of damaged lengths; chunks of the recorder have about 1 MiB
_DEFINITIONS: dict[int, type[Schema | Channel | Metadata]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}


@dataclass
class RepairResult:
    """Result of a repair.

    `messages`, `chunks`: recovered; `damaged`: records with a wrong checksum or content; `skipped`:
    bytes that are not records, usually at the end of the file; `orphans`: messages of a channel whose
    definition is lost; `seconds` from the first to the last message.
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
        """Seconds between the first and the last message."""
        return (self.end_ns - self.start_ns) / 1e9

    def as_json(self) -> dict[str, Any]:
        """Convert to plain values."""
        return asdict(self)

    def lines(self, target: Path) -> list[str]:
        """Format the result as text."""
        lines = [f"{target}: {self.messages} messages in {self.chunks} chunks, {self.seconds:.1f} s"]
        if self.damaged or self.skipped or self.orphans:
            lines.append(
                f"not recovered: {self.damaged} damaged records, {self.skipped} bytes that are not records, "
                f"{self.orphans} messages of unknown channels"
            )
        return lines

    def count(self, message: Message) -> None:
        """Count a message."""
        self.start_ns = min(self.start_ns, message.log_time) if self.messages else message.log_time
        self.end_ns = max(self.end_ns, message.log_time)
        self.messages += 1


def repair(source: Path, target: Path) -> RepairResult:
    """Copy every readable message of a file to a new file with an index.

    Parameters
    ----------
    source
        The damaged file; it is not changed.
    target
        The new file; it must not exist.

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
    with source.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        definitions = _Definitions()
        for record in _records(data, RepairResult()):
            definitions.add(record)
        with os.fdopen(create(target), "wb") as output:
            try:
                _copy(data, definitions, Writer(output), result)
                if not result.messages:
                    raise KnownError(f"{source}: there is no readable message in it")
            except BaseException:
                target.unlink()
                raise
    return result


@dataclass
class _Definitions:
    """All schemas and channels of the file; the end of a file repeats them."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, record: McapRecord) -> None:
        """Add a record if it is a definition."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record


class _Renumbered:
    """Registers definitions with the writer on first use and maps old numbers to new ones."""

    def __init__(self, definitions: _Definitions, writer: Writer) -> None:
        self._old, self._writer = definitions, writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}

    def channel(self, number: int) -> int | None:
        """Return the new number of a channel; None if its definition is lost."""
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


def _copy(data: mmap.mmap, definitions: _Definitions, writer: Writer, result: RepairResult) -> None:
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
            result.count(record)
            writer.add_message(
                channel_id=channel,
                log_time=record.log_time,
                publish_time=record.publish_time,
                data=record.data,
                sequence=record.sequence,
            )
    writer.finish()


def _records(data: mmap.mmap, result: RepairResult) -> Iterator[McapRecord]:
    """Yield messages, definitions and metadata of a file; count and skip damaged parts."""
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


def _read(record: bytes, result: RepairResult) -> Iterator[McapRecord]:
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
    except Exception:  # decompression and parsing raise many types on damaged bytes
        result.damaged += 1
        return
    yield from found


def _break_up(content: bytes) -> list[McapRecord]:
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    if chunk.uncompressed_size > _MAX_CHUNK_BYTES:
        raise KnownError("the size of the chunk is not plausible")
    return breakup_chunk(chunk, validate_crc=True)


def _end_of_record(data: mmap.mmap, position: int) -> int | None:
    """Return the end of the record at a position; None if there is no complete record."""
    if position + _FRAME.size > len(data):
        return None
    opcode, length = _FRAME.unpack_from(data, position)
    end = position + _FRAME.size + length
    if not Opcode.HEADER <= opcode <= Opcode.DATA_END or end > len(data):
        return None
    if opcode == Opcode.CHUNK and not _lengths_agree(data, position, length):
        return None
    if opcode == Opcode.MESSAGE_INDEX and not _is_index(data, position, length):
        return None
    return int(end)


def _is_index(data: mmap.mmap, position: int, length: int) -> bool:
    """Whether the two lengths of a message index agree; a wrong length would skip chunks."""
    if length < 6:
        return False
    (entries,) = struct.unpack_from("<I", data, position + _FRAME.size + 2)
    return bool(length == 6 + entries)


def _lengths_agree(data: mmap.mmap, position: int, length: int) -> bool:
    """Whether the two lengths in a chunk agree."""
    name = position + _CHUNK.size
    for compression in _NAMES:
        if data[name : name + len(compression)] == compression:
            at = name + len(compression)
            (content,) = struct.unpack_from("<Q", data, at) if at + 8 <= len(data) else (-1,)
            return bool(at + 8 + content == position + _FRAME.size + length)
    return False


def _next_chunk(data: mmap.mmap, start: int) -> int:
    """Return the position of the next complete chunk, or the end of the file."""
    at = start + _CHUNK.size
    while (at := data.find(_NAMES[0], at)) >= 0:
        position = at - _CHUNK.size
        if data[position] == Opcode.CHUNK and _end_of_record(data, position) is not None:
            return position
        at += 1
    return len(data)
