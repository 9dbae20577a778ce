"""Reads small files and tables; what is too large, too deep or no text is refused in one line."""

import csv
import re
import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from comotion_schemas.errors import InputError, KnownError

# The parser takes time that grows with the square of the length of a dotted key.
_LONG_KEY = re.compile(r"""(?:(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*\.[ \t]*){20}""")
_DEPTH = 30
_MAX_LINE = 100_000


def read_text(path: Path, most_bytes: int) -> str:
    """Read a text file of a size that its kind allows.

    Raises
    ------
    InputError
        If it cannot be read, is larger, or is not UTF-8; the message names the file.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(most_bytes + 1)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    if len(raw) > most_bytes:
        raise InputError(f"{path}: more than {most_bytes} bytes")
    try:
        return raw.decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML of a depth that people write.

    Raises
    ------
    ValueError
        If it is not valid, or nested more than 30 times.
    """
    if _LONG_KEY.search(text):
        raise KnownError("a key has more than 20 parts")
    try:
        content = tomllib.loads(text)
        deep = _is_deeper(content, _DEPTH)
    except RecursionError:
        deep = True
    if deep:
        raise KnownError(f"nested more than {_DEPTH} times")
    return content


def _is_deeper(value: object, depth: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return depth < 0 or any(_is_deeper(item, depth - 1) for item in inner)


def read_cells(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield number and cells of each line of a CSV table that is not empty; the first names the columns.

    They are separated as there: by commas, semicolons or tabs.

    Raises
    ------
    InputError
        If a line has more or fewer cells than the first, or it is no text; the message names the line.
    OSError
        If it cannot be opened.
    """
    width = 0
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            separator = max(",;\t", key=file.readline(_MAX_LINE).count)
            file.seek(0)
            # A file without line ends may be larger than the memory.
            rows = csv.reader(iter(partial(file.readline, _MAX_LINE), ""), delimiter=separator)
            for row in rows:
                width = width or len(row)
                if row and len(row) != width:
                    raise InputError(f"line {rows.line_num} has {len(row)} cells, the first line {width}")
                if row:
                    yield rows.line_num, [cell.strip() for cell in row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"it is not a table ({error})") from None
