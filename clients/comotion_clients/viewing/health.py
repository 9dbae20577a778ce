"""Health views: scene snapshots -> curves of rates, lags and sizes, a summary page, and a log. Pure."""

from collections.abc import Sequence

import numpy as np

from comotion_schemas import Event
from comotion_schemas.colours import GREY, HUES, RGB, Palette, legible
from comotion_schemas.naming import Names, event_words
from comotion_schemas.text import counted

from ..scene_rows import HypothesisRow, Snapshot
from ..watch_columns import HYPOTHESIS_COLUMNS, SOURCE_COLUMNS, duration, markdown, number
from .hypotheses import labels
from .paths import Paths, clock
from .shapes import LEGEND, Document, Entry, Level, Number, Points, Shape

PERIOD_S = 0.5
"""Interval of the curves and the page."""
ROWS = 30
"""Most rows of a table on the page."""
_LOG = "log"
_MAX_LAG_S = 60.0
"""A larger difference to the clock is not a lag: a recording is played with its original stamps."""
_ALARM = (213, 94, 0)
_SERVICE, _VIEW = (150, 150, 150), (204, 121, 167)


class Health:
    """Draws snapshots as curves, a page and log entries."""

    def __init__(self) -> None:
        self._rates, self._lags = Paths("rates"), Paths("lags")
        self._hues: dict[str, RGB] = {}
        self._states: dict[str, str] = {}
        self._lost: dict[str, int] = {}

    def draw(self, snapshot: Snapshot, view_age: float | None) -> list[Shape]:
        """Draw a snapshot.

        Parameters
        ----------
        snapshot
            The snapshot.
        view_age
            Seconds from the publication of an update until this viewer showed it; None: unknown.
        """
        return [
            *self._curves(snapshot, view_age),
            *_sizes(snapshot),
            *legend(snapshot.hypotheses),
            Document("summary", summary(snapshot)),
            *self._changes(snapshot),
        ]

    def _curves(self, snapshot: Snapshot, view_age: float | None) -> list[Shape]:
        shapes: list[Shape] = []
        for row in snapshot.sources:
            hue = self._hues.setdefault(row.name, HUES[len(self._hues) % len(HUES)])
            shapes.append(Number(self._rates(row.name), row.rate, row.name, hue))
            if row.state == "ok" and abs(row.lag) < _MAX_LAG_S:
                shapes.append(Number(self._lags(row.name), 1e3 * row.lag, row.name, hue))
        service = snapshot.service
        if service.seq >= 0:
            shapes.append(Number("rates/.service", service.rate, "service", _SERVICE))
        if abs(service.lag) < _MAX_LAG_S:
            shapes.append(Number("lags/.service", 1e3 * service.lag, "service", _SERVICE))
        if view_age is not None:
            shapes.append(Number("lags/.view", 1e3 * view_age, "this view", _VIEW))
        return shapes

    def _changes(self, snapshot: Snapshot) -> list[Shape]:
        service = snapshot.service
        shapes = self._change("service", service.state, f"service is {service.state}", service.message)
        shapes += self._loss("updates", service.lost)
        for row in snapshot.sources:
            words = {"ok": f"source {row.name} is live", "gone": f"source {row.name} has left"}
            text = words.get(row.state, f"source {row.name} is {row.state}")
            shapes += self._change(
                f"source {row.name}", row.state, text, f"in {row.space}" if row.space else ""
            )
            shapes += self._loss(row.name, row.lost)
        return shapes

    def _change(self, who: str, state: str, text: str, detail: str) -> list[Shape]:
        # A recording begins before its service has spoken.
        if self._states.get(who, "absent") == state:
            return []
        self._states[who] = state
        level: Level = "INFO" if state == "ok" else "WARN"
        text = f"{text}: {detail}" if detail else text
        return [Entry(_LOG, text) if level == "INFO" else Entry(_LOG, text, level, _ALARM)]

    def _loss(self, who: str, lost: int) -> list[Shape]:
        more = lost - self._lost.get(who, 0)
        self._lost[who] = lost
        return [Entry(_LOG, f"{more} lost of {who}", "WARN", _ALARM)] if more > 0 else []


def event_entry(event: Event, palette: Palette, names: Names) -> Entry:
    """Build the log entry of an event, in the colour of its hypothesis."""
    return Entry(_LOG, event_words(event, names), colour=palette.legible(event.hypothesis))


def _sizes(snapshot: Snapshot) -> list[Shape]:
    """Curves of the number of features per hypothesis."""
    shapes: list[Shape] = [
        Number(f"sizes/{row.id}", row.size, f"hypothesis {row.id}", row.colour) for row in snapshot.hypotheses
    ]
    if snapshot.tracks:
        shapes.append(Number("sizes/undetermined", snapshot.undetermined, "undetermined", GREY))
    return shapes


def legend(hypotheses: Sequence[HypothesisRow]) -> list[Shape]:
    """Legend of the colours: a dot and a label per hypothesis, sorted by id, in a grid."""
    rows = sorted(hypotheses, key=lambda row: row.id)
    shown = rows[: LEGEND.columns * LEGEND.rows]
    words = [f"{row.name} {row.state}, {row.size}" for row in shown]
    if len(rows) > len(shown):
        words[-1] += f" (+{len(rows) - len(shown)})"
    slots = np.arange(len(shown))
    column, row = slots % LEGEND.columns, slots // LEGEND.columns
    positions = np.stack([LEGEND.width * column, LEGEND.height * row], axis=1).astype(np.float32)
    dots = positions - np.array((0.0, LEGEND.lift), np.float32)
    shades = np.array([row.colour for row in shown], np.uint8).reshape(-1, 3)
    return [
        Points("legend/dots", dots, shades, radius=6.0),
        labels("legend/words", [legible(row.colour) for row in shown], positions, tuple(words)),
    ]


def summary(snapshot: Snapshot) -> str:
    """Format a snapshot as a page in Markdown."""
    service = snapshot.service
    lines = [
        f"**{snapshot.scene}**: service {service.state}, {number(service.rate, 1)} Hz, "
        f"lag {duration(service.lag)}, {service.lost} lost; "
        f"{counted(snapshot.tracks, 'feature')}, {snapshot.undetermined} undetermined",
        "",
        f"Data of **{clock(snapshot.stamp_ns)} UTC**. If that is many seconds ago, this display is "
        "too slow: a browser without a graphics card, for one. Look at fewer views, or at a file (--save).",
        "",
    ]
    lines += [*markdown(snapshot.sources[:ROWS], SOURCE_COLUMNS), ""]
    lines += markdown(snapshot.hypotheses[:ROWS], HYPOTHESIS_COLUMNS[1:])  # the colours are in the legend
    return "\n".join(lines)
