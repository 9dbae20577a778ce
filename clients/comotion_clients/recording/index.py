"""Writes the missing index of an MCAP file in place; the file must end after a complete chunk."""

import os
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.exceptions import EndOfFile, McapError
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC

from comotion_schemas.errors import KnownError

from .disk import write_all


def write_index(path: Path) -> None:
    """Append the summary section (MCAP's index) to a file whose records are all complete.

    Parameters
    ----------
    path
        A recording that ends after a complete chunk; it is changed in place.

    Raises
    ------
    OSError
        If the file cannot be read or the disk is full; the file is then unchanged.
    ValueError
        If a record is damaged; use :func:`comotion_clients.recording.repair.repair` instead.
    """
    summary = _Summary()
    with path.open("rb") as file:
        try:
            for start, length, record in _records(file):
                summary.add(start, length, record)
        except McapError as error:
            raise KnownError(f"{path}: {error}") from None
        end = file.seek(0, os.SEEK_END)
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC)
    try:
        write_all(descriptor, summary.tail(end))
    except OSError:
        os.ftruncate(descriptor, end)
        raise
    finally:
        os.close(descriptor)


def _records(file: BinaryIO) -> Iterator[tuple[int, int, McapRecord]]:
    """Yield (offset, length, record) for every record up to the end of the file."""
    start = len(MCAP0_MAGIC)
    try:
        for record in StreamReader(file, emit_chunks=True).records:
            yield start, file.tell() - start, record
            start = file.tell()
    except EndOfFile:
        return


def _no_statistics() -> Statistics:
    return Statistics(
        message_count=0,
        schema_count=0,
        channel_count=0,
        attachment_count=0,
        metadata_count=0,
        chunk_count=0,
        message_start_time=0,
        message_end_time=0,
        channel_message_counts=defaultdict(int),
    )


@dataclass
class _Summary:
    """The summary section of an MCAP file."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    statistics: Statistics = field(default_factory=_no_statistics)

    def add(self, start: int, length: int, record: McapRecord) -> None:
        """Add a record of the data section."""
        if isinstance(record, Chunk):
            self._add_chunk(start, length, record)
        elif isinstance(record, MessageIndex):
            chunk = self.chunks[-1]
            chunk.message_index_offsets[record.channel_id] = start
            chunk.message_index_length += length
        elif isinstance(record, Metadata):
            self.metadata.append(MetadataIndex(offset=start, length=length, name=record.name))

    def _add_chunk(self, start: int, length: int, chunk: Chunk) -> None:
        self.chunks.append(
            ChunkIndex(
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                chunk_start_offset=start,
                chunk_length=length,
                message_index_offsets={},
                message_index_length=0,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        for record in breakup_chunk(chunk, validate_crc=True):
            if isinstance(record, Schema):
                self.schemas[record.id] = record
            elif isinstance(record, Channel):
                self.channels[record.id] = record
            elif isinstance(record, Message):
                self._count(record)

    def _count(self, message: Message) -> None:
        s = self.statistics
        s.message_start_time = (
            min(s.message_start_time, message.log_time) if s.message_count else message.log_time
        )
        s.message_end_time = max(s.message_end_time, message.log_time)
        s.message_count += 1
        s.channel_message_counts[message.channel_id] += 1

    def tail(self, offset: int) -> bytes:
        """Bytes that complete a file of `offset` bytes: data end, summary, footer and magic."""
        builder = RecordBuilder()
        DataEnd(0).write(builder)
        start = offset + builder.count
        s = self.statistics
        s.schema_count, s.channel_count = len(self.schemas), len(self.channels)
        s.chunk_count, s.metadata_count = len(self.chunks), len(self.metadata)
        for record in (*self.schemas.values(), *self.channels.values(), s, *self.chunks, *self.metadata):
            record.write(builder)
        Footer(summary_start=start, summary_offset_start=0, summary_crc=0).write(builder)
        return bytes(builder.end()) + MCAP0_MAGIC
