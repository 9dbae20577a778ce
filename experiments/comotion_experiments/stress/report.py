"""The results as a page in Markdown."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from ..study import Row
from ..tables import Column, Table, filled, means
from .catalogue import FAMILIES, Family
from .experiment import METHODS

_WIDTH = 110
# NaN where a metric does not apply.
_COLUMNS = (
    Column("nmi_apart", "NMI", 3),
    Column("delay", "delay, s", 2),
    Column("healing", "healing, s", 1),
    Column("kept", "kept", 2),
    Column("ids", "ids", 1),
    Column("spurious", "spurious", 0),
)
_OPENING = """Made by `comotion dev reproduce stress`. Scenes that are not clean: trackers restart,
features drift, bodies rest. {seeds}{part} All scenes are made up; the parameters of each family are in
`comotion_experiments.stress`. The thesis method has equal weights and the σ_switch that suits the scene's
noise. Every cell is a mean over seeds{both}."""
_BOTH = " of the default method; NMI also of the thesis method"


def markdown(rows: Sequence[Row]) -> str:
    """For a document and a terminal."""
    seeds = list(dict.fromkeys(row["seed"] for row in rows))
    families = [FAMILIES[name] for name in dict.fromkeys(row["case"] for row in rows)]
    odd = all(seed % 2 for seed in seeds)
    role = "even ones are for development" if odd else "not all odd: those that are even are for development"
    opening = _OPENING.format(
        seeds=f"Seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))} ({role}).",
        part=f" Here are {len(families)} of {len(FAMILIES)} families."
        if len(families) < len(FAMILIES)
        else "",
        both=_BOTH if len({row["setting"] for row in rows}) > 1 else "",
    )
    parts: dict[str, str | Table] = {"opening": textwrap.fill(" ".join(opening.split()), _WIDTH)}
    for group in dict.fromkeys(family.group for family in families):
        of_group = [family for family in families if family.group == group]
        parts[group.replace(" ", "_")] = _table(rows, of_group)
    return filled(Path(__file__).with_name("page.md"), parts)


def _table(rows: Sequence[Row], families: Sequence[Family]) -> Table:
    """A line for each family of a group, means over seeds: NMI of each method, the rest of the first one."""
    lines = [[figures for m in METHODS if (figures := _means(rows, family, m))] for family in families]
    # A column without a value in the whole group says nothing.
    columns = [
        column
        for column in _COLUMNS
        if any(not math.isnan(figures[column.key]) for line in lines for figures in line)
    ]
    titles = (column.title for column in columns)
    table = Table(("family", "what happens", *titles), words=2)
    for family, line in zip(families, lines, strict=True):
        shown = (line if column.key == "nmi_apart" else line[:1] for column in columns)
        cells = (
            " / ".join(_short(column.of(figures)) for figures in some)
            for column, some in zip(columns, shown, strict=True)
        )
        table.add(f"`{family.name}`", family.title, *cells)
    return table


def _means(rows: Sequence[Row], family: Family, method: str) -> dict[str, float]:
    """Means over seeds of a family under a method; empty if it was not run."""
    same = [row for row in rows if (row["case"], row["setting"]) == (family.name, method)]
    return means([{column.key: row[column.key] for column in _COLUMNS} for row in same]) if same else {}


def _short(text: str) -> str:
    """Write a number below 1 without the zero."""
    return text[1:] if text.startswith("0.") else text
