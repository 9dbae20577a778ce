"""Makes text from outside harmless to show: in terminals, logs, pages, metrics, frames and file names.

And counts and durations in words.
"""

import logging
import math
from typing import Any

MOST = 4096
"""Most characters of a text in a message."""


def shown(text: str, most: int = MOST) -> str:
    """Make a text harmless to show.

    Characters that are no glyph become a space, a run of them one: control characters (C0, C1, escape), ends
    of lines, marks that turn the direction of what follows, surrogates. What is longer is cut, with an
    ellipsis. Brackets stay: who formats text, as rich or Markdown, escapes its markup.

    Parameters
    ----------
    most
        Most characters of the result, at least 1.
    """
    if not text.isprintable():
        text = " ".join(
            "".join(glyph if glyph.isprintable() else "\0" for glyph in text).replace("\0", " ").split()
        )
    return text if len(text) <= most else f"{text[: most - 1]}…"


def counted(number: int, noun: str) -> str:
    """Say how many there are, in words: ``1 hypothesis``, ``2 hypotheses``, ``3 lost messages``."""
    if number != 1:
        noun = f"{noun[:-2]}es" if noun.endswith("is") else f"{noun}s"
    return f"{number} {noun}"


def counter_words(name: str, number: int) -> str:
    """Say what a counter of a Status holds: ``1 overrun``, ``3 partly late``."""
    words = name.replace("_", " ")
    return counted(number, words[:-1]) if words.endswith("s") else f"{number} {words}"


def duration(seconds: float) -> str:
    """Format a duration in at most seven characters: ms, s, min, h or days."""
    if not math.isfinite(seconds):
        return "-"
    size = abs(seconds)
    if size < 0.9995:
        return f"{seconds * 1e3:.0f} ms"
    if size < 99.95:
        return f"{seconds:.1f} s"
    for unit, length, limit in (("min", 60.0, 7200.0), ("h", 3600.0, 172800.0), ("d", 86400.0, math.inf)):
        if size < limit:
            return f"{seconds / length:.0f} {unit}"
    return "-"


class LogFormatter(logging.Formatter):
    """Writes a message as one line, and the lines of a trace indented: none looks like another message."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - the name of the base class
        """Format the message of a record."""
        return shown(super().formatMessage(record))

    def formatException(self, ei: Any) -> str:  # noqa: N802
        """Format the trace of an exception."""
        return "\n".join(f"  {shown(line)}" for line in super().formatException(ei).splitlines())
