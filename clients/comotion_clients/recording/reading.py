"""Reads a recording for clients: file -> messages. Needs the extra `record`."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Self

from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.stream_reader import CRCValidationError
from zstandard import ZstdError

from comotion_schemas import DEFAULT_SCENE, DecodeError, Message, decode
from comotion_schemas.errors import KnownError
from comotion_schemas.recording import MESSAGE_ENCODING, kind_of

# Raised by mcap and its decompressors on damaged bytes.
_DAMAGED = (
    McapError,
    CRCValidationError,
    ZstdError,
    struct.error,
    RuntimeError,
    OSError,
    KeyError,
    UnicodeDecodeError,
)


class Reading:
    """An open recording; a context manager.

    Attributes
    ----------
    invalid
        Number of invalid payloads that were left out so far.

    Raises
    ------
    ValueError
        If the file is damaged or incomplete; reading may also raise it.
    OSError
        If the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.invalid = 0
        self._path = path
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as error:
            raise OSError(f"{path}: {error.strerror}") from None
        try:
            self._reader: McapReader = make_reader(self._file, validate_crcs=True)
        except _DAMAGED as error:
            self._file.close()
            raise self._damaged(error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def scene(self) -> str:
        """Name of the scene that was recorded."""
        try:
            summary = self._reader.get_summary()
        except _DAMAGED as error:
            raise self._damaged(error) from None
        topics = [channel.topic for channel in summary.channels.values()] if summary else []
        return next((topic.split("/")[2] for topic in topics if kind_of(topic)), DEFAULT_SCENE)

    def messages(self) -> Iterator[tuple[int, Message]]:
        """Yield (receipt in ns, message) in the order of receipt."""
        try:
            for _, channel, logged in self._reader.iter_messages():
                if channel.message_encoding != MESSAGE_ENCODING or kind_of(channel.topic) is None:
                    continue
                try:
                    yield logged.log_time, decode(logged.data)
                except DecodeError:
                    self.invalid += 1
        except _DAMAGED as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> KnownError:
        return KnownError(
            f"{self._path}: damaged or never completed ({type(error).__name__}); "
            f"try: comotion record --repair {self._path}"
        )
