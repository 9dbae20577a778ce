"""Shows a snapshot as a screen that fits the terminal, a plain line, or JSON."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

from rich.console import Group
from rich.table import Table
from rich.text import Text

from comotion_schemas.colours import GREY, as_hex
from comotion_schemas.plain import plain
from comotion_schemas.text import counted, counter_words, duration

from .bodies import JointRow
from .scene_rows import EventRow, HypothesisRow, ServiceRow, Snapshot, SourceRow
from .watch_columns import (
    HYPOTHESIS_COLUMNS,
    POSE_COLUMNS,
    SOURCE_COLUMNS,
    Column,
    Row,
    lost,
    number,
    table,
)

Sort = Literal["size", "name", "age"]
SORTS: tuple[Sort, ...] = get_args(Sort)

# By size, the largest first; by name or id; sources by age, the oldest first, hypotheses the youngest first.
_SOURCES: dict[Sort, Callable[[SourceRow], Any]] = {
    "size": lambda row: (-row.tracks, row.name),
    "name": lambda row: row.name,
    "age": lambda row: (-row.age, row.name),
}
_HYPOTHESES: dict[Sort, Callable[[HypothesisRow], Any]] = {
    "size": lambda row: (-row.size, row.id),
    "name": lambda row: row.id,
    "age": lambda row: (row.age, row.id),
}
_SERVICE_STYLES = {"ok": "green", "degraded": "yellow", "stalled": "bold red", "silent": "bold red"}
_EVENT_STYLES = {"born": "green", "split": "cyan", "merged": "magenta", "ended": "dim"}
_EVENT_STYLES |= {"absent": "yellow", "returned": "green", "joined": "green", "released": "magenta"}
_JOINED_KINDS = {"fixed", "prismatic", "revolute"}
_MAX_EVENT_ROWS = 4
_MAX_PROBLEM_ROWS = 4
WHOLE = 100_000
"""Height of a screen on which nothing is left out."""
_COUNTERS_SHOWN = ("late", "partly_late", "overflow", "reordered", "duplicates", "overruns")


def render(
    snapshot: Snapshot, width: int, height: int, sort: Sort, *, keys: bool = True, pose: bool = False
) -> Group:
    """Render a snapshot in `width` x `height` characters.

    `keys`: with a line about the keys; `pose`: with angular speed and pose instead of space and links.
    """
    head = [*_cropped(_head(snapshot), width), *_problem_lines(snapshot.service, whole=not keys)]
    foot = [Text(f"sorted by {sort}   s: sort   p: pose   q: quit", style="dim")] if keys else []
    sources = sorted(snapshot.sources, key=_SOURCES[sort])
    hypotheses = sorted(snapshot.hypotheses, key=_HYPOTHESES[sort])
    heights = share_rows(
        height - len(head) - len(foot), (len(sources), len(hypotheses), len(snapshot.events))
    )
    return Group(
        *(_cropped(head, width) if keys else head),
        *_table("sources", sources, SOURCE_COLUMNS, heights[0], width),
        *_table("hypotheses", hypotheses, POSE_COLUMNS if pose else HYPOTHESIS_COLUMNS, heights[1], width),
        *_cropped(_event_lines(snapshot.events, heights[2]), width),
        *_cropped(foot, width),
    )


def share_rows(height: int, wanted: tuple[int, int, int]) -> tuple[int, int, int]:
    """Divide the rows of the screen among sources, hypotheses and events.

    Events get up to four rows, sources up to half of the others, hypotheses the rest. Rows that one
    table does not need go to the others. Each table also has one title row. `height`: rows of the screen;
    `wanted`: number of sources, hypotheses and events.
    """
    height_left = max(height - 3, 0)
    events = min(wanted[2], _MAX_EVENT_ROWS, height_left // 3)
    sources = min(wanted[0], max((height_left - events) // 2, height_left - events - wanted[1]))
    hypotheses = min(wanted[1], height_left - events - sources)
    return sources, hypotheses, min(wanted[2], height_left - sources - hypotheses)


def _head(snapshot: Snapshot) -> list[Text]:
    service = snapshot.service
    first = Text.assemble(
        ("comotion ", "bold"),
        f"{snapshot.scene}   service ",
        (service.state, _SERVICE_STYLES.get(service.state, "dim")),
        f"   {number(service.rate, 1)} Hz   age {duration(service.age)}   lag {duration(service.lag)}   ",
        lost(service.lost, losing=service.losing),
        " lost",
    )
    tracks, hypotheses = counted(snapshot.tracks, "track"), counted(snapshot.current, "hypothesis")
    undetermined = f", {snapshot.undetermined} undetermined" if snapshot.undetermined else ""
    count = len(snapshot.hypotheses) - snapshot.current
    absent = f", {count} absent" if count else ""
    second = Text(f"{tracks} in {hypotheses}{absent}{undetermined}   ")
    second.append_text(_problems(service))
    return [first, second, *_joints(snapshot.joints, snapshot.hypotheses)]


def _joints(joints: Sequence[JointRow], hypotheses: Sequence[HypothesisRow]) -> list[Text]:
    """A line about the joints that are known; none without."""
    shown = [row for row in joints if row.kind in _JOINED_KINDS]
    if not shown:
        return []
    colours = {row.id: row.colour for row in hypotheses}
    line = Text("joints   ", style="bold dim")
    for row in shown:
        line.append("●", style=as_hex(colours.get(row.child, GREY)))
        position = "" if row.position == "-" else f", at {row.position.partition(' ±')[0]}{row.unit}"
        line.append(f" {row.words}{position}   ")
    return [line]


def _problems(service: ServiceRow) -> Text:
    """Message of the service, and its counts of dropped and rejected data so far."""
    parts = [counter_words(n, service.counters[n]) for n in _COUNTERS_SHOWN if service.counters.get(n)]
    parts += [f"{count} rejected as {reason}" for reason, count in sorted(service.rejected.items()) if count]
    total = f"   so far: {', '.join(parts)}" if parts else ""
    return Text.assemble((service.message, "dim" if service.state == "ok" else "yellow"), (total, "yellow"))


def _problem_lines(service: ServiceRow, *, whole: bool) -> list[Text]:
    """A line for each problem that lasts; on a screen only some fit."""
    lines = [Text.assemble((f"{row.kind} ", "bold red"), row.text) for row in service.problems]
    if whole or len(lines) <= _MAX_PROBLEM_ROWS:
        return lines
    more = len(lines) - _MAX_PROBLEM_ROWS + 1
    return [*lines[: _MAX_PROBLEM_ROWS - 1], Text(f"... and {more} more problems", style="dim")]


def _table(
    title: str, rows: Sequence[Row], columns: Sequence[Column[Row]], height_left: int, width: int
) -> list[Table | Text]:
    hidden = len(rows) - height_left
    shown = table(rows[: height_left if hidden <= 0 else max(height_left - 1, 0)], columns, width)
    more = [Text(f"... and {hidden + 1} more {title}", style="dim")] if hidden > 0 and height_left else []
    return [shown, *more]


def _event_lines(events: Sequence[EventRow], height_left: int) -> list[Text]:
    shown = [
        Text.assemble(f"{duration(e.ago):>8} ago  ", (e.words, _EVENT_STYLES.get(e.kind, "")))
        for e in events[:height_left]
    ]
    return [Text("last events" if events else "no events yet", style="bold dim"), *shown]


def _cropped(lines: Sequence[Text], width: int) -> list[Text]:
    for line in lines:
        line.truncate(width, overflow="ellipsis")
    return list(lines)


def plain_line(snapshot: Snapshot) -> str:
    """Format a snapshot as one line for logs and pipes."""
    service = snapshot.service
    head = f"{snapshot.scene} service {service.state}"
    if snapshot.service.seq >= 0:
        head += f" {number(service.rate, 1)} Hz age {duration(service.age)} lost {service.lost}"
    hypotheses = counted(snapshot.current, "hypothesis")
    body = f"{counted(snapshot.tracks, 'track')} {hypotheses} {snapshot.undetermined} undetermined"
    problem = [_problems(service).plain] if service.state != "ok" and service.message else []
    lasting = [f"{row.kind}: {row.text}" for row in service.problems]
    sources = [
        f"{row.name}{'' if row.state == 'ok' else f' {row.state.upper()}'} "
        f"{number(row.rate, 1)} Hz age {duration(row.age)} lost {row.lost}"
        for row in snapshot.sources
    ]
    return " | ".join([head, body, *sources, *problem, *lasting])


def as_json(snapshot: Snapshot) -> dict[str, Any]:
    """Convert a snapshot to plain values for JSON; unknown values are None."""
    values: dict[str, Any] = plain(snapshot)
    for row in values["hypotheses"]:
        row["colour"] = as_hex(row["colour"])
    return values
