"""Writes one MCAP file of a scene: a channel for each key, complete chunks, an index."""

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from importlib import metadata
from io import BufferedWriter
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

from mcap.writer import Writer

from comotion_schemas import QOS, Message
from comotion_schemas.errors import KnownError
from comotion_schemas.export import json_schemas
from comotion_schemas.keys import Kind, kind_of
from comotion_schemas.recording import (
    MESSAGE_ENCODING,
    METADATA,
    PROFILE,
    SCHEMA_ENCODING,
    publish_time,
    sequence,
)


class Definition(NamedTuple):
    """A schema of MCAP: its name, how it is written (``jsonschema``, ``ros2msg``), and its text."""

    name: str
    encoding: str
    data: bytes


class TopicWriter(Writer):
    """An MCAP writer that registers channels and schemas where a topic first has a message.

    `output` is a binary file; `profile` and `library` are in its header.
    """

    def __init__(self, output: BinaryIO, *, profile: str, library: str = "comotion") -> None:
        super().__init__(output)
        self.start(profile=profile, library=library)
        self._schema_ids: dict[Definition, int] = {}
        self._channel_ids: dict[str, int] = {}

    def channel(self, topic: str, definition: Definition | None, encoding: str) -> int:
        """Id of the channel of a topic; its first call says schema (None: unknown) and encoding."""
        if topic not in self._channel_ids:
            if definition is not None and definition not in self._schema_ids:
                self._schema_ids[definition] = self.register_schema(*definition)
            schema_id = 0 if definition is None else self._schema_ids[definition]
            self._channel_ids[topic] = self.register_channel(topic, encoding, schema_id)
        return self._channel_ids[topic]


class StorageError(OSError):
    """The disk is full or failed; what was committed before is intact."""


class RecordingFile:
    """Writes one file; a context manager that completes the file at its end.

    ::

        with RecordingFile(Path("take.mcap"), scene="default") as file:
            file.add(keys.stream("obs", "cam"), time.time_ns(), payload, message)

    Parameters
    ----------
    path
        The file; it must not exist.
    scene
        Name of the scene, for the metadata.
    number
        Number of the file in a series, from 1.

    Attributes
    ----------
    size, messages
        Bytes and messages that are on the disk; they end with a complete chunk whatever fails later.

    Raises
    ------
    OSError
        If the file exists or cannot be created.
    StorageError
        From every method, if writing fails. Committed messages remain, without an index; the file is
        closed.
    """

    def __init__(self, path: Path, *, scene: str, number: int = 1) -> None:
        self.path = path
        self.messages = 0
        self.size = 0
        self._waiting = 0
        self._output: BufferedWriter = path.open("xb")
        library = f"comotion {metadata.version('comotion')}"
        self._writer = TopicWriter(self._output, profile=PROFILE, library=library)
        self.describe(METADATA, {"scene": scene, "file": str(number)})

    def add(self, key: str, log_ns: int, payload: bytes, message: Message | None) -> None:
        """Append one payload.

        `log_ns` is the time of receipt, nanoseconds since the Unix epoch; `payload` is as received, `message`
        decoded, None if it is invalid.

        Raises
        ------
        ValueError
            If it is not a key of messages.
        StorageError
            If writing fails.
        """
        kind = kind_of(key)
        if kind is None:
            raise KnownError(f"{key!r} is not a key of messages")
        published_ns, number = publish_time(message, log_ns), sequence(message)
        with self._on_disk():
            channel = self._writer.channel(key, _definition(kind), MESSAGE_ENCODING)
            self._writer.add_message(channel, log_ns, payload, published_ns, number)
            self._waiting += 1

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Complete the chunk and append a metadata record."""
        with self._on_disk():
            self._writer.flush()
            self._writer.add_metadata(name, dict(values))

    def flush(self) -> None:
        """Complete the current chunk and write it: all messages so far are then in the file."""
        with self._on_disk():
            self._writer.flush()

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._output.closed:
            self.flush()
            with self._on_disk():
                self._writer.finish()
            self._output.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @contextmanager
    def _on_disk(self) -> Iterator[None]:
        """Where a chunk has been completed, see to it that it is on the disk; else cut the file before it."""
        try:
            yield
            if self._output.tell() == self.size:
                return
            self._output.flush()
            # Some file systems report a full disk only here.
            os.fdatasync(self._output.fileno())
        except OSError as error:
            with suppress(OSError):
                os.truncate(self.path, self.size)
            # What waits in the buffer is discarded. Without an index: it would list the lost chunk.
            self._output.raw.close()
            raise StorageError(
                f"{self.path}: {error.strerror or error}; the {self.messages} messages written before "
                f"are intact, {self._waiting} newer ones are lost; it has no index: comotion record "
                f"--repair {self.path}"
            ) from error
        self.size = self._output.tell()
        self.messages, self._waiting = self.messages + self._waiting, 0


@cache
def _definition(kind: Kind) -> Definition:
    name = QOS[kind].message
    return Definition(f"comotion.{name}/1", SCHEMA_ENCODING, json.dumps(json_schemas()[name]).encode())
