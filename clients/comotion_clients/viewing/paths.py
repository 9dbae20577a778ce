"""Names as viewers take them: paths that need no escape, and words that every font has."""

import re


class Paths:
    """A path of its own for every name, made of letters that need no escape."""

    def __init__(self, root: str) -> None:
        self._root = root
        self._paths: dict[str, str] = {}

    def __call__(self, name: str) -> str:
        """Path of a name; the same each time."""
        if name not in self._paths:
            plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", name)[:64] or "_"
            taken = set(self._paths.values())
            path, number = f"{self._root}/{plain}", 2
            while path in taken:
                path, number = f"{self._root}/{plain}-{number}", number + 1
            self._paths[name] = path
        return self._paths[name]


def plain(text: str) -> str:
    """Replace letters that a viewer's font may lack, which has ended one."""
    return text.encode("latin-1", "replace").decode("latin-1")
