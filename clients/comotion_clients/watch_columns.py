"""The tables of a terminal: their columns, and what a cell shows of a row. Texts are no markup."""

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

from rich.table import Table
from rich.text import Text

from comotion_schemas import Joint
from comotion_schemas.colours import as_hex
from comotion_schemas.naming import Names
from comotion_schemas.text import duration

from .bodies import JointRow, joint_row
from .scene_rows import HypothesisRow, SourceRow

Row = TypeVar("Row")

STATE_STYLES = {
    "ok": "green",
    "silent": "yellow",
    "stalled": "bold red",
    "gone": "dim",
    "moving": "bold",
    "static": "",
}


@dataclass(frozen=True)
class Column(Generic[Row]):
    """A column of a table: title, width (None: as needed), content, least terminal width that shows it."""

    title: str
    width: int | None
    cell: Callable[[Row], str | Text]
    left: bool = False
    from_width: int = 0


def table(rows: Iterable[Row], columns: Sequence[Column[Row]], width: int | None = None) -> Table:
    """A table of the columns that a terminal of a width in characters shows; None: of all."""
    drawn = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), show_header=True, header_style="bold dim")
    shown = [column for column in columns if width is None or width >= column.from_width]
    for column in shown:
        justify: Literal["left", "right"] = "left" if column.left else "right"
        kept = column.width is not None
        drawn.add_column(column.title, justify=justify, width=column.width, no_wrap=kept, overflow="ellipsis")
    for row in rows:
        cells = [column.cell(row) for column in shown]
        # A table takes a plain string for markup.
        drawn.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in cells))
    return drawn


def markdown(rows: Iterable[Row], columns: Sequence[Column[Row]]) -> list[str]:
    """Lines of the same table in Markdown; cells are shown as they are, without links, images and HTML."""
    lines = [[column.title for column in columns], ["---"] * len(columns)]
    lines += [[re.sub(r"([^\w\s])", r"\\\1", str(column.cell(row))) for column in columns] for row in rows]
    return [f"|{'|'.join(line)}|" for line in lines]


def lost(count: int, *, losing: bool) -> Text:
    """Format a number of lost messages; red while messages are being lost."""
    style = "bold red" if losing else "yellow" if count else ""
    return Text(str(count), style=style)


def _motion(row: HypothesisRow) -> Text:
    """State of a hypothesis; a question mark follows while it is not confirmed."""
    if row.absent:
        return Text("absent", style="dim")
    style = STATE_STYLES.get(row.state, "dim") if row.confirmed else "dim"
    return Text(row.state if row.confirmed else f"{row.state[:11]}?", style=style)


def _speed(row: HypothesisRow) -> str:
    return "-" if row.speed is None else f"{number(row.speed, 3)} {row.unit}/s"


def _extent(row: HypothesisRow) -> str:
    """Lengths of the box, the longest first."""
    if row.extent is None:
        return "-"
    digits = 0 if row.unit == "px" else 2
    return "×".join(number(length, digits) for length in sorted(row.extent, reverse=True))


def _components(values: list[float] | None, digits: int) -> str:
    return "-" if values is None else " ".join(number(round(value, digits) + 0.0, digits) for value in values)


SOURCE_COLUMNS: tuple[Column[SourceRow], ...] = (
    Column("source", 18, lambda r: Text(r.name, "dim" if r.state == "gone" else ""), left=True),
    Column("state", 7, lambda r: Text(r.state, STATE_STYLES.get(r.state, "dim")), left=True),
    Column("rate Hz", 7, lambda r: number(r.rate, 1)),
    Column("age", 7, lambda r: duration(r.age)),
    Column("lost", 6, lambda r: lost(r.lost, losing=r.losing), from_width=50),
    Column("tracks", 6, lambda r: str(r.tracks), from_width=57),
    Column("lag", 8, lambda r: duration(r.lag), from_width=66),
    Column("space", 12, lambda r: r.space, left=True, from_width=79),
    Column("clock", 8, lambda r: "" if r.clock is None else f"{1e3 * r.clock:+.0f} ms", from_width=88),
)
_IDENTITY_COLUMNS: tuple[Column[HypothesisRow], ...] = (
    Column(" ", 1, lambda r: Text("●", as_hex(r.colour))),
    Column("hypothesis", 10, lambda r: r.name[:10]),
    Column("state", 12, _motion, left=True),
    Column("size", 5, lambda r: str(r.size)),
    Column("age", 7, lambda r: duration(r.age)),
)
HYPOTHESIS_COLUMNS: tuple[Column[HypothesisRow], ...] = (
    *_IDENTITY_COLUMNS,
    Column("conf", 5, lambda r: number(r.confidence, 2), from_width=46),
    Column("speed", 11, _speed, from_width=58),
    Column("space", 16, lambda r: r.space, left=True, from_width=75),
    Column("linked to", 9, lambda r: ", ".join(map(str, r.linked)), left=True, from_width=85),
    Column("extent", 14, _extent, from_width=100),
)
POSE_COLUMNS: tuple[Column[HypothesisRow], ...] = (
    *_IDENTITY_COLUMNS[:-1],
    Column("speed", 11, _speed, from_width=45),
    Column(
        "turning", 10, lambda r: "-" if r.turning is None else f"{number(r.turning, 2)} rad/s", from_width=56
    ),
    Column(
        "moved since birth",
        20,
        lambda r: _components(r.translation, 1 if r.unit == "px" else 3),
        from_width=77,
    ),
    Column(
        "turned, °",
        13,
        lambda r: _components(r.rotation and [*map(math.degrees, r.rotation)], 0),
        from_width=91,
    ),
    Column("extent", 14, _extent, from_width=106),
)


JOINT_COLUMNS: tuple[Column[JointRow], ...] = (
    Column("parent", None, lambda r: str(r.parent), left=True),
    Column("child", None, lambda r: str(r.child), left=True),
    Column("kind", None, lambda r: r.kind, left=True),
    Column("conf", None, lambda r: f"{r.confidence:.2f}", left=True),
    Column("axis", None, lambda r: r.axis, left=True),
    Column("position", None, lambda r: _in_unit(r.position, r), left=True),
    Column("rate per s", None, lambda r: _in_unit(r.rate, r), left=True),
    Column("range seen", None, lambda r: _in_unit(r.range, r), left=True),
    Column("in words", None, lambda r: r.words, left=True),
)


def _in_unit(text: str, row: JointRow) -> str:
    return text if text == "-" else f"{text}{row.unit}"


def joint_table(joints: Sequence[Joint], names: Names | None = None) -> Table:
    """A table with one row per joint, the surest kinds first."""
    unsure = {"free", "undetermined"}
    ordered = sorted(joints, key=lambda joint: (joint.kind in unsure, joint.parent, joint.child))
    return table((joint_row(joint, names) for joint in ordered), JOINT_COLUMNS)


def number(value: float, digits: int) -> str:
    """Format a number; a dash if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
