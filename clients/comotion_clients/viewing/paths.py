"""Paths and texts that the viewer can show, of names and times."""

import re

import numpy as np

from comotion_schemas.text import shown

# Characters of a text in the viewer.
_MOST = 500


class Paths:
    """Maps each name to a unique path of characters that need no escape."""

    def __init__(self, root: str) -> None:
        self._root = root
        self._paths: dict[str, str] = {}

    def __call__(self, name: str) -> str:
        """Return the path of a name."""
        if name not in self._paths:
            plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", name)[:64] or "_"
            taken = set(self._paths.values())
            path, number = f"{self._root}/{plain}", 2
            while path in taken:
                path, number = f"{self._root}/{plain}-{number}", number + 1
            self._paths[name] = path
        return self._paths[name]


def plain(text: str) -> str:
    """Replace characters outside Latin-1: a missing glyph has crashed the viewer. Cut what is too long."""
    return shown(text, _MOST).encode("latin-1", "replace").decode("latin-1")


def clock(stamp_ns: int) -> str:
    """Format the time of day in UTC to a tenth of a second."""
    return str(np.datetime64(stamp_ns, "ns").astype("datetime64[ms]"))[11:21]
