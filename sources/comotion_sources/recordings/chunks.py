"""Refuses chunks of an MCAP file that would unpack to more than a recorder writes."""

import io
import struct
from collections.abc import Iterable
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.records import ChunkIndex

from comotion_schemas.errors import KnownError

_MAX_BYTES = 64 << 20
"""A recorder's chunks have 1 MiB plus one message of at most 16 MiB; other recorders write up to some MiB."""
_OPCODE_AND_LENGTH = 9
_FIXED = struct.Struct("<QQQI")
_FRAME_BYTES = 32


def require_bounded(file: BinaryIO, chunks: Iterable[ChunkIndex]) -> None:
    """Check what each chunk announces, and what its compressed data announces, before anything is unpacked.

    Raises
    ------
    ValueError
        If it is more than 64 MiB.
    struct.error
        If a chunk is cut short.
    """
    for index in chunks:
        file.seek(index.chunk_start_offset + _OPCODE_AND_LENGTH, io.SEEK_SET)
        *_, announced, _ = _FIXED.unpack(file.read(_FIXED.size))
        (length,) = struct.unpack("<I", file.read(4))
        compression = file.read(min(length, _FRAME_BYTES))
        file.read(8)
        start = file.read(_FRAME_BYTES)
        if max(announced, index.uncompressed_size, _unpacked(compression, start)) > _MAX_BYTES:
            raise KnownError("a chunk unpacks to more than 64 MiB")


def _unpacked(compression: bytes, start: bytes) -> int:
    """Bytes that compressed data unpacks to, as far as its first bytes say; 0: as much as they claim."""
    try:
        if compression == b"zstd":
            size: int = zstandard.get_frame_parameters(start).content_size
            return 0 if size in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR) else size
        if compression == b"lz4":
            return int(lz4.frame.get_frame_info(start)["content_size"])
    except (zstandard.ZstdError, RuntimeError):
        pass
    return 0
