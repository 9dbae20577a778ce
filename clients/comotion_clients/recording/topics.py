"""Writes messages to an MCAP file by their topic. Needs the extra `record`."""

from typing import IO, Any, NamedTuple, cast

from mcap.writer import Writer


class Definition(NamedTuple):
    """A schema of MCAP: its name, how it is written (``jsonschema``, ``ros2msg``), and its text."""

    name: str
    encoding: str
    data: bytes


class TopicWriter:
    """An MCAP writer that registers channels and schemas where a topic first has a message.

    Parameters
    ----------
    output
        A binary file, or what has its methods `write`, `tell` and `flush`.
    profile, library
        Of the header of the file.
    options
        Of :class:`mcap.writer.Writer`.
    """

    def __init__(
        self, output: object, *, profile: str = "", library: str = "comotion", **options: Any
    ) -> None:
        self._writer = Writer(cast("IO[bytes]", output), **options)
        self._writer.start(profile=profile, library=library)
        self._schemas: dict[Definition, int] = {}
        self._channels: dict[str, int] = {}

    def add(
        self,
        topic: str,
        definition: Definition | None,
        encoding: str,
        data: bytes,
        log_ns: int,
        publish_ns: int | None = None,
        sequence: int = 0,
    ) -> None:
        """Append a message.

        Parameters
        ----------
        topic, definition, encoding
            Topic, schema (None: unknown) and encoding of its messages; the first message of a topic counts.
        data
            The message.
        log_ns, publish_ns
            Log time and publish time, ns since the Unix epoch; None: the same.
        sequence
            Number of the message, 32 bits.
        """
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic=topic, message_encoding=encoding, schema_id=self._schema(definition)
            )
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=log_ns,
            publish_time=log_ns if publish_ns is None else publish_ns,
            data=data,
            sequence=sequence,
        )

    def describe(self, name: str, values: dict[str, str]) -> None:
        """Complete the chunk and append a metadata record."""
        self._writer.flush()
        self._writer.add_metadata(name, values)

    def flush(self) -> None:
        """Complete the chunk."""
        self._writer.flush()

    def finish(self) -> None:
        """Complete the chunk and write the index; the output stays open."""
        self._writer.finish()

    def _schema(self, definition: Definition | None) -> int:
        if definition is None:
            return 0
        if definition not in self._schemas:
            self._schemas[definition] = self._writer.register_schema(*definition)
        return self._schemas[definition]
