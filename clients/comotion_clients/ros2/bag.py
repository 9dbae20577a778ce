"""ROS 2 messages -> a bag: one MCAP file that ``ros2 bag`` and Foxglove read. Needs the extra ``record``."""

from pathlib import Path
from typing import BinaryIO, Self

from .types import definition


class Bag:
    """Writes messages to a new MCAP file; a context manager.

    Raises
    ------
    ImportError
        If mcap is not installed.
    OSError
        If the file exists or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        from mcap.writer import Writer

        self._file: BinaryIO = path.open("xb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library="comotion")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.finish()
        self._file.close()

    def write(self, topic: str, kind: str, raw: bytes, stamp_ns: int) -> None:
        """Append a message in CDR."""
        if topic not in self._channels:
            if kind not in self._schemas:
                self._schemas[kind] = self._writer.register_schema(
                    name=kind, encoding="ros2msg", data=definition(kind).encode()
                )
            self._channels[topic] = self._writer.register_channel(
                topic=topic, message_encoding="cdr", schema_id=self._schemas[kind]
            )
        self._writer.add_message(
            channel_id=self._channels[topic], log_time=stamp_ns, publish_time=stamp_ns, data=raw
        )
