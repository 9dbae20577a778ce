"""Log lines: lines of several processes -> one stream, each line with the name of its process."""

import threading
from itertools import cycle
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.text import Text

_COLOURS = (
    "bold",
    "cyan",
    "green",
    "yellow",
    "magenta",
    "blue",
    "bright_cyan",
    "bright_green",
    "bright_magenta",
)


class LogLines:
    """Prints prefixed lines, coloured on a terminal, or writes them to a file.

    Parameters
    ----------
    names
        Names of the processes, for width and colour of the prefix.
    path
        File for the lines; None: standard output. Needed while another process owns the terminal.
    """

    def __init__(self, names: list[str], path: Path | None = None) -> None:
        self._width = max(map(len, names), default=0)
        self._styles = dict(zip(names, cycle(_COLOURS), strict=False))
        self._lock = threading.Lock()
        self._file = None if path is None else path.open("w", encoding="utf-8")
        self._console = Console(file=self._file, soft_wrap=True, highlight=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()

    def write(self, name: str, line: str) -> None:
        """Print one line of a process."""
        prefix = Text(f"{name:>{self._width}} | ", style=self._styles[name])
        with self._lock:
            self._console.print(prefix + Text.from_ansi(line))
