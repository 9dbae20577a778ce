"""Reads the messages of a scene from an MCAP recording, in the order of receipt. Needs the extra `record`."""

import io
import struct
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import lz4.frame
import zstandard
from mcap.reader import SeekingReader
from mcap.summary import Summary

from .codec import DecodeError, Message, decode_on
from .errors import RecordingError
from .keys import DEFAULT_SCENE, Kind, StreamKind, kind_of, publisher_of
from .recording import MESSAGE_ENCODING
from .types import is_name

_MAX_RECORD_BYTES = 512 * 1024 * 1024
_MAX_CHUNK_BYTES = 64 << 20
"""A recorder's chunks have 1 MiB plus one message of at most 16 MiB; other recorders write up to some MiB."""
_OPCODE_AND_LENGTH = 9
_CHUNK_HEAD = struct.Struct("<QQQI")
_FRAME_BYTES = 32


@dataclass(frozen=True, slots=True)
class Logged:
    """One recorded payload with its key and time of receipt (ns since the Unix epoch)."""

    kind: Kind
    key: str
    log_ns: int
    payload: bytes

    @property
    def name(self) -> str:
        """Name of the source or component, or the name of the scene for updates of the service."""
        return publisher_of(self.key)

    def decode(self) -> Message | None:
        """Decode the message; None if it is invalid or not of the kind and publisher of its key."""
        try:
            return decode_on(self.key, self.payload)
        except DecodeError:
            return None


class MessageLog(ExitStack):
    """An MCAP recording of a scene; a context manager.

    Attributes
    ----------
    path
        The file.
    scene
        Name of the scene that was recorded.
    start_ns, end_ns
        Receipt of the first and of the last message, nanoseconds since the Unix epoch.
    sources
        Publishers of observations, truth, joint states and previews, and which of these each has sent.
    invalid
        Number of invalid payloads that :meth:`decoded` has left out so far.

    Raises
    ------
    RecordingError
        If the file is missing, damaged, incomplete, or holds no message of a scene; reading may also
        raise it.
    """

    gap_s = 0.1
    """About the time between two messages, between two passes of a replay."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.invalid = 0
        try:
            self._file = self.enter_context(path.open("rb"))
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror or error}") from None
        try:
            self._reader, summary = self._open()
        except BaseException:
            self.close()
            raise
        statistics = summary.statistics
        assert statistics is not None  # noqa: S101 - checked by _open
        self.start_ns, self.end_ns = statistics.message_start_time, statistics.message_end_time
        self._topics = {
            channel.topic: kind
            for channel in summary.channels.values()
            if channel.message_encoding == MESSAGE_ENCODING
            and (kind := kind_of(channel.topic))
            # Ignore keys that do not end in a valid name.
            and is_name(publisher_of(channel.topic))
        }
        self.scene = next((key.split("/")[2] for key in self._topics), DEFAULT_SCENE)
        self.sources: dict[str, set[StreamKind]] = {}
        for key, kind in sorted(self._topics.items(), key=lambda topic: publisher_of(topic[0])):
            if kind not in {"hypotheses", "status"}:
                self.sources.setdefault(publisher_of(key), set()).add(cast("StreamKind", kind))

    @property
    def seconds(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end_ns - self.start_ns) / 1e9

    def messages(
        self, kinds: Collection[Kind] | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Logged]:
        """Yield payloads in the order of receipt.

        Parameters
        ----------
        kinds
            Kinds of messages; None: all.
        start_ns, end_ns
            Range of the time of receipt, inclusive; None: no limit.
        """
        topics = [key for key, kind in self._topics.items() if kinds is None or kind in kinds]
        try:
            records = self._reader.iter_messages(topics, starting_at=start_ns, ending_at=end_ns)
            for _, channel, message in records:
                yield Logged(self._topics[channel.topic], channel.topic, message.log_time, message.data)
        except Exception as error:  # mcap and its decompressors raise many types on damaged bytes
            raise self._damaged(error) from None

    def decoded(self, kinds: Collection[Kind] | None = None) -> Iterator[tuple[int, Message]]:
        """Yield (receipt in ns, message) for all valid payloads of some kinds; count the others."""
        for logged in self.messages(kinds):
            message = logged.decode()
            if message is None:
                self.invalid += 1
            else:
                yield logged.log_ns, message

    def _open(self) -> tuple[SeekingReader, Summary]:
        try:
            reader = SeekingReader(self._file, validate_crcs=True, record_size_limit=_MAX_RECORD_BYTES)
            summary = reader.get_summary()
            if summary is not None:
                self._check_chunks(summary)
        except Exception as error:  # as above
            raise self._damaged(error) from None
        if summary is None or summary.statistics is None:
            raise self._damaged("it has no index")
        if not any(kind_of(channel.topic) for channel in summary.channels.values()):
            raise RecordingError(f"{self.path}: it holds no message of a scene")
        return reader, summary

    def _check_chunks(self, summary: Summary) -> None:
        """Check what each chunk announces, and what its compressed data announces, before it is unpacked."""
        for index in summary.chunk_indexes:
            self._file.seek(index.chunk_start_offset + _OPCODE_AND_LENGTH, io.SEEK_SET)
            *_, announced, _ = _CHUNK_HEAD.unpack(self._file.read(_CHUNK_HEAD.size))
            (length,) = struct.unpack("<I", self._file.read(4))
            compression = self._file.read(min(length, _FRAME_BYTES))
            self._file.read(8)
            unpacked = _unpacked(compression, self._file.read(_FRAME_BYTES))
            if max(announced, index.uncompressed_size, unpacked) > _MAX_CHUNK_BYTES:
                raise RecordingError("a chunk unpacks to more than 64 MiB")

    def _damaged(self, why: Any) -> RecordingError:
        reason = type(why).__name__ if isinstance(why, Exception) else why
        return RecordingError(
            f"{self.path}: damaged or never completed ({reason}); try: comotion record --repair {self.path}"
        )


def _unpacked(compression: bytes, start: bytes) -> int:
    """Bytes that compressed data unpacks to, by its first bytes; 0: as much as the reader requests."""
    try:
        if compression == b"zstd":
            size: int = zstandard.get_frame_parameters(start).content_size
            return 0 if size in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR) else size
        if compression == b"lz4":
            return int(lz4.frame.get_frame_info(start)["content_size"])
    except (zstandard.ZstdError, RuntimeError):
        pass
    return 0
