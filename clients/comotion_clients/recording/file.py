"""Writes one MCAP file of a scene: payloads -> one channel per key, complete chunks, an index."""

import contextlib
import json
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any, Self, cast

from mcap.writer import Writer

from comotion_schemas import QOS, Message
from comotion_schemas.errors import KnownError
from comotion_schemas.export import json_schemas
from comotion_schemas.qos import Kind
from comotion_schemas.recording import (
    MESSAGE_ENCODING,
    METADATA,
    PROFILE,
    SCHEMA_ENCODING,
    kind_of,
    publish_time,
    sequence,
)

from .disk import ChunkStream
from .index import write_index

CHUNK_BYTES = 1024 * 1024
"""Size at which the writer completes a chunk; the default of the MCAP library."""


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

    Raises
    ------
    OSError
        If the file exists or cannot be created.
    StorageError
        From every method, if writing fails. Committed messages remain, with an index if there is
        space for it; the file is closed.
    """

    def __init__(self, path: Path, *, scene: str, number: int = 1) -> None:
        self.path = path
        self.messages = 0
        self._stream = ChunkStream(path)
        # mcap uses only write, tell and flush of a stream.
        self._writer = Writer(cast("Any", self._stream), chunk_size=CHUNK_BYTES)
        self._channels: dict[str, int] = {}
        self._schemas: dict[Kind, int] = {}
        self._uncommitted = 0
        self._open = True
        self._writer.start(profile=PROFILE, library=f"comotion {metadata.version('comotion')}")
        self.describe(METADATA, {"scene": scene, "file": str(number)})

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._stream.committed

    def add(self, key: str, log_ns: int, payload: bytes, message: Message | None) -> None:
        """Append one payload.

        Parameters
        ----------
        key
            Key of the payload; it must be a key of messages.
        log_ns
            Time of receipt, nanoseconds since the Unix epoch.
        payload
            The payload as received.
        message
            The decoded payload; None if it is invalid.

        Raises
        ------
        ValueError
            If it is not a key of messages.
        StorageError
            If writing fails.
        """
        self._writer.add_message(
            channel_id=self._channel(key),
            log_time=log_ns,
            publish_time=publish_time(message, log_ns),
            data=payload,
            sequence=sequence(message),
        )
        self._uncommitted += 1
        if self._stream.pending:  # the message completed a chunk
            self._commit()

    def describe(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        self._writer.flush()
        self._writer.add_metadata(name, dict(values))
        self._commit()

    def flush(self) -> None:
        """Complete the current chunk and write it: all messages so far are then in the file."""
        self._writer.flush()
        self._commit()

    def close(self) -> None:
        """Write the index and close the file."""
        if not self._open:
            return
        self._writer.finish()
        self._commit()
        self._release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _channel(self, key: str) -> int:
        if key not in self._channels:
            kind = kind_of(key)
            if kind is None:
                raise KnownError(f"{key!r} is not a key of messages")
            self._channels[key] = self._writer.register_channel(
                topic=key, message_encoding=MESSAGE_ENCODING, schema_id=self._schema(kind)
            )
        return self._channels[key]

    def _schema(self, kind: Kind) -> int:
        if kind not in self._schemas:
            name = QOS[kind].message
            self._schemas[kind] = self._writer.register_schema(
                name=f"comotion.{name}/1",
                encoding=SCHEMA_ENCODING,
                data=json.dumps(json_schemas()[name]).encode(),
            )
        return self._schemas[kind]

    def _commit(self) -> None:
        try:
            self._stream.commit()
        except OSError as error:
            self._release()
            indexed = False
            # The writer's own index would list the chunk that could not be written.
            with contextlib.suppress(OSError):
                write_index(self.path)
                indexed = True
            advice = "" if indexed else f"; it has no index: comotion record --repair {self.path}"
            raise StorageError(
                f"{self.path}: {error.strerror or error}; the {self.messages} messages written before "
                f"are intact, {self._uncommitted} newer ones are lost{advice}"
            ) from error
        self.messages += self._uncommitted
        self._uncommitted = 0

    def _release(self) -> None:
        self._open = False
        self._stream.close()
