"""Reads MCAP recordings: file -> messages of a scene in the order of receipt. Needs the extra `record`."""

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader
from mcap.stream_reader import CRCValidationError
from mcap.summary import Summary

from comotion_schemas import DecodeError, Message, ObservationBatch, TruthBatch, decode
from comotion_schemas.keys import last_chunk
from comotion_schemas.qos import Kind
from comotion_schemas.recording import MESSAGE_ENCODING, kind_of
from comotion_schemas.types import is_name

from ..errors import RecordingError
from .chunks import require_bounded

# Raised by mcap and its decompressors on damaged bytes.
_DAMAGED = (
    McapError,
    CRCValidationError,
    struct.error,
    zstandard.ZstdError,
    zlib.error,
    RuntimeError,
    EOFError,
    KeyError,
    UnicodeDecodeError,
    MemoryError,
    OverflowError,
)
_MAX_RECORD_BYTES = 512 * 1024 * 1024  # a recorder's chunks have 1 MiB plus one message of at most 16 MiB


@dataclass(frozen=True, slots=True)
class Logged:
    """One recorded payload with its time of receipt (ns since the Unix epoch).

    `name` is the name of the source or component, or the name of the scene for updates of the service.
    """

    kind: Kind
    name: str
    log_ns: int
    payload: bytes

    def decode(self) -> Message | None:
        """Decode the message; None if it is invalid or its source does not match its key."""
        try:
            message = decode(self.payload)
        except DecodeError:
            return None
        owner = getattr(message, "source", None)
        return message if owner is None or owner == self.name else None


class MessageLog:
    """An MCAP recording of a scene; a context manager.

    Attributes
    ----------
    path
        The file.
    start_ns, end_ns
        Receipt of the first and of the last message, nanoseconds since the Unix epoch.
    sources
        Sorted names of the publishers of observations, truth, joint states and previews.

    Raises
    ------
    RecordingError
        If the file is missing, damaged, incomplete, or holds no message of a scene; reading may also
        raise it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror or error}") from None
        try:
            self._reader, summary = self._open()
        except BaseException:
            self._file.close()
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
            and is_name(last_chunk(channel.topic))
        }
        streams = {"obs", "truth", "joints", "preview"}
        self.sources = sorted({last_chunk(key) for key, kind in self._topics.items() if kind in streams})

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
            found = self._reader.iter_messages(topics, starting_at=start_ns, ending_at=end_ns)
            for _, channel, message in found:
                kind = self._topics[channel.topic]
                name = channel.topic.split("/")[2] if kind == "hypotheses" else last_chunk(channel.topic)
                yield Logged(kind, name, message.log_time, message.data)
        except _DAMAGED as error:
            raise self._damaged(error) from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _open(self) -> tuple[SeekingReader, Summary]:
        try:
            reader = SeekingReader(self._file, validate_crcs=True, record_size_limit=_MAX_RECORD_BYTES)
            summary = reader.get_summary()
        except (*_DAMAGED, OSError, ValueError) as error:
            raise self._damaged(error) from None
        if summary is None or summary.statistics is None:
            raise self._damaged("it has no index")
        try:
            require_bounded(self._file, summary.chunk_indexes)
        except (*_DAMAGED, OSError, ValueError) as error:
            raise self._damaged(error) from None
        if not any(kind_of(channel.topic) for channel in summary.channels.values()):
            raise RecordingError(f"{self.path}: it holds no message of a scene")
        return reader, summary

    def _damaged(self, why: Any) -> RecordingError:
        reason = type(why).__name__ if isinstance(why, Exception) else why
        return RecordingError(
            f"{self.path}: damaged or never completed ({reason}); try: comotion record --repair {self.path}"
        )


def logged_batches(path: str | Path) -> Iterator[tuple[int, TruthBatch | ObservationBatch]]:
    """Yield (receipt in ns, message) for all valid observations and truth of a recording.

    Raises
    ------
    RecordingError
        As :class:`MessageLog`.
    """
    with MessageLog(Path(path)) as log:
        for logged in log.messages({"obs", "truth"}):
            message = logged.decode()
            if isinstance(message, TruthBatch | ObservationBatch):
                yield logged.log_ns, message
