"""Converts a recording to an MCAP file of Foxglove's own messages. Needs the extra `foxglove`.

Its topics are those of :mod:`comotion_clients.foxglove.scene`. Log times are those of the recording.
"""

from dataclasses import dataclass, field
from pathlib import Path

import foxglove

from comotion_schemas.errors import KnownError
from comotion_schemas.message_log import MessageLog
from comotion_schemas.naming import Names
from comotion_schemas.text import counted

from ..following import play
from ..foxglove.scene import FoxgloveScene


@dataclass
class Exported:
    """Result of an export: number of messages by topic; `invalid` payloads were left out."""

    messages: dict[str, int] = field(default_factory=dict)
    invalid: int = 0

    def lines(self, target: Path) -> list[str]:
        """Format the result as text."""
        total = sum(self.messages.values())
        lines = [f"{target}: {counted(total, 'message')} on {counted(len(self.messages), 'topic')}"]
        lines += [f"  {topic}: {count}" for topic, count in sorted(self.messages.items())]
        if self.invalid:
            lines.append(f"left out as invalid: {self.invalid}")
        return lines


def export(source: Path, target: Path, names: Names | None = None) -> Exported:
    """Convert a recording to a file for Foxglove.

    Parameters
    ----------
    source
        A recording of ``comotion record`` that includes the service.
    target
        The new file; it must not exist.
    names
        Names of hypotheses by id.

    Raises
    ------
    ValueError
        If the recording is damaged or holds no update of a service.
    OSError
        If a file cannot be read or written, or `target` exists.
    """
    context = foxglove.Context()
    with MessageLog(source) as log, target.open("xb") as output:
        try:
            with foxglove.open_mcap(output, context=context):
                scene = FoxgloveScene(context, names)
                play(scene, log.decoded())
            if not scene.logged.get("/numbers"):
                raise KnownError(f"{source}: it holds no hypotheses; was the service recorded?")
        except BaseException:
            target.unlink()
            raise
    return Exported(scene.logged, log.invalid)
