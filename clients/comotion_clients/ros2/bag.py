"""Writes ROS 2 messages to a bag: an MCAP file for ``ros2 bag`` and Foxglove. Needs the extra ``record``."""

from contextlib import ExitStack
from functools import cache
from pathlib import Path

from ..recording.file import Definition, TopicWriter
from .types import definition


class Bag(ExitStack):
    """Writes messages to a new MCAP file; a context manager.

    Raises
    ------
    OSError
        If the file exists or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._writer = TopicWriter(self.enter_context(path.open("xb")), profile="ros2")
        self.callback(self._writer.finish)

    def write(self, topic: str, kind: str, raw: bytes, stamp_ns: int) -> None:
        """Append a message in CDR."""
        channel = self._writer.channel(topic, _definition(kind), "cdr")
        self._writer.add_message(channel, stamp_ns, raw, stamp_ns)


@cache
def _definition(kind: str) -> Definition:
    return Definition(kind, "ros2msg", definition(kind).encode())
