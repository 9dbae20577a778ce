"""Results as tables, built once for a terminal and for Markdown, and pages of them."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rich.table

from comotion_clients.watch_columns import number

_NAMES = re.compile(r"\{(\w+)\}")


@dataclass
class Table:
    """Rows of cells under titles; rich prints it, :meth:`markdown` writes it."""

    titles: Sequence[str]  # of the columns
    words: int = 1  # number of columns, from the left, that hold words; the others hold numbers
    rows: list[Sequence[str]] = field(default_factory=list)  # the cells
    # Rows in bold, and rows after which a terminal shows a gap.
    strong: set[int] = field(default_factory=set)
    ended: set[int] = field(default_factory=set)

    def add(self, *cells: str, strong: bool = False) -> None:
        """Add a row."""
        if strong:
            self.strong.add(len(self.rows))
        self.rows.append(cells)

    def end_section(self) -> None:
        """Leave a gap after the last row."""
        self.ended.add(len(self.rows) - 1)

    def __rich__(self) -> rich.table.Table:
        drawn = rich.table.Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for k, title in enumerate(self.titles):
            drawn.add_column(title, justify="left" if k < self.words else "right", no_wrap=True)
        for k, row in enumerate(self.rows):
            style = "bold" if k in self.strong else None
            drawn.add_row(*row, style=style, end_section=k in self.ended)
        return drawn

    def markdown(self) -> str:
        """The table as Markdown, without an end of line."""
        rule = ["---"] * self.words + ["---:"] * (len(self.titles) - self.words)
        head, *rows = (f"| {' | '.join(cells)} |" for cells in [self.titles, *self.rows])
        return "\n".join([head, f"|{'|'.join(rule)}|", *rows])


def document(parts: Iterable[str | Table]) -> str:
    """Write a page in Markdown: texts and tables in order; empty ones are left out."""
    texts = (part.markdown() if isinstance(part, Table) else part for part in parts)
    return "\n\n".join(text for text in texts if text) + "\n"


def filled(template: Path, parts: Mapping[str, str | Table]) -> str:
    """Fill a page in Markdown, where ``{name}`` stands for a part; a section that lacks one is left out."""
    texts = {name: part.markdown() if isinstance(part, Table) else part for name, part in parts.items()}
    sections = re.split(r"^(?=## )", template.read_text(encoding="utf-8"), flags=re.MULTILINE)
    page = "".join(section for section in sections if set(_NAMES.findall(section)) <= texts.keys())
    page = _NAMES.sub(lambda match: texts[match[1]], page)
    return re.sub(r"\n{3,}", "\n\n", page).strip() + "\n"


class Column(NamedTuple):
    """A column of numbers: which value of a row it shows, its title, digits, and factor."""

    key: str
    title: str
    digits: int
    times: float = 1.0

    def of(self, row: Mapping[str, float]) -> str:
        """The cell of a row."""
        return number(self.times * row[self.key], self.digits)


def spread(values: Any, digits: int = 3) -> str:
    """Mean and, after ±, standard deviation of the values that are finite; a dash without any."""
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return "-"
    tail = f" ± {finite.std():.{digits}f}" if len(finite) > 1 else ""
    return f"{finite.mean():.{digits}f}{tail}"


def mean(values: Iterable[float]) -> float:
    """Mean of the values that are not NaN; NaN without any."""
    finite = [value for value in values if not math.isnan(value)]
    return float(np.mean(finite)) if finite else math.nan


def means(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of every value over rows of the same names, by :func:`mean`."""
    return {name: mean([row[name] for row in rows]) for name in rows[0]}
