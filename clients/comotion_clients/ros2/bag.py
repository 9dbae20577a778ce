"""Writes ROS 2 messages to a bag: an MCAP file for ``ros2 bag`` and Foxglove. Needs the extra ``record``."""

from functools import cache
from pathlib import Path
from typing import BinaryIO, Self

from ..recording.file import Definition, TopicWriter
from .types import definition


class Bag:
    """Writes messages to a new MCAP file; a context manager.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("xb")
        self._writer = TopicWriter(self._file, profile="ros2")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.finish()
        self._file.close()

    def write(self, topic: str, kind: str, raw: bytes, stamp_ns: int) -> None:
        """Append a message in CDR."""
        self._writer.add(topic, _definition(kind), "cdr", raw, stamp_ns)


@cache
def _definition(kind: str) -> Definition:
    return Definition(kind, "ros2msg", definition(kind).encode())
