"""Draws how a scene is: curves of rates, lags and sizes, a summary page, and a log. Pure."""

from collections.abc import Iterator, Sequence

import numpy as np

from comotion_schemas.colours import GREY, HUES, RGB, legible
from comotion_schemas.text import counted, duration

from ..scene_rows import HypothesisRow, Snapshot
from ..watch_columns import HYPOTHESIS_COLUMNS, SOURCE_COLUMNS, markdown, number
from .drawing import Shape, entry, labels, page, points, value, warning
from .paths import Paths, clock

PERIOD_S = 0.5
"""Interval of the curves and the page."""
ROWS = 30
"""Most rows of a table on the page."""
LEGEND_COLUMNS, LEGEND_ROWS = 4, 2
LEGEND_WIDTH, LEGEND_HEIGHT, LEGEND_LIFT = 4.8, 1.8, 0.35
"""How far labels of the legend are apart, from (0, 0) on, and how much higher their dots are."""
_MAX_LAG_S = 60.0
"""A larger difference to the clock is not a lag: a recording is played with its original stamps."""
_SERVICE, _VIEW = (150, 150, 150), (204, 121, 167)


class Health:
    """Draws snapshots as curves, a page and log entries."""

    def __init__(self) -> None:
        self._rates, self._lags = Paths("rates"), Paths("lags")
        self._hues: dict[str, RGB] = {}
        self._states: dict[str, str] = {}
        self._lost: dict[str, int] = {}

    def draw(self, snapshot: Snapshot, view_age: float | None, stamp_ns: int) -> list[Shape]:
        """Draw a snapshot.

        `view_age` is in s from the publication of an update until this viewer showed it, None: unknown;
        `stamp_ns` is the time of what is drawn.
        """
        sizes = [
            value(f"sizes/{row.id}", row.size, f"hypothesis {row.id}", row.colour)
            for row in snapshot.hypotheses
        ]
        if snapshot.tracks:
            sizes.append(value("sizes/undetermined", snapshot.undetermined, "undetermined", GREY))
        return [
            *self._curves(snapshot, view_age),
            *sizes,
            *legend(snapshot.hypotheses),
            page("summary", summary(snapshot)),
            *self._changes(snapshot, stamp_ns),
        ]

    def _curves(self, snapshot: Snapshot, view_age: float | None) -> list[Shape]:
        shapes: list[Shape] = []
        for row in snapshot.sources:
            hue = self._hues.setdefault(row.name, HUES[len(self._hues) % len(HUES)])
            shapes.append(value(self._rates(row.name), row.rate, row.name, hue))
            if row.state == "ok" and abs(row.lag) < _MAX_LAG_S:
                shapes.append(value(self._lags(row.name), 1e3 * row.lag, row.name, hue))
        service = snapshot.service
        if service.seq >= 0:
            shapes.append(value("rates/.service", service.rate, "service", _SERVICE))
        if abs(service.lag) < _MAX_LAG_S:
            shapes.append(value("lags/.service", 1e3 * service.lag, "service", _SERVICE))
        if view_age is not None:
            shapes.append(value("lags/.view", 1e3 * view_age, "this view", _VIEW))
        return shapes

    def _changes(self, snapshot: Snapshot, stamp_ns: int) -> Iterator[Shape]:
        """Lines of the log: states that have changed, and losses."""
        service = snapshot.service
        states: list[tuple[str, str, str, str]] = [
            ("service", service.state, f"service is {service.state}", service.message)
        ]
        counts = [("updates", service.lost)]
        for row in snapshot.sources:
            words = {"ok": f"source {row.name} is live", "gone": f"source {row.name} has left"}
            text = words.get(row.state, f"source {row.name} is {row.state}")
            states.append((f"source {row.name}", row.state, text, f"in {row.space}" if row.space else ""))
            counts.append((row.name, row.lost))
        for name, state, text, detail in states:
            # A recording begins before its service has spoken.
            if self._states.get(name, "absent") != state:
                self._states[name] = state
                line = entry if state == "ok" else warning
                yield line(stamp_ns, f"{text}: {detail}" if detail else text)
        for name, lost in counts:
            if (newly := lost - self._lost.get(name, 0)) > 0:
                yield warning(stamp_ns, f"{newly} lost of {name}")
            self._lost[name] = lost


def legend(hypotheses: Sequence[HypothesisRow]) -> list[Shape]:
    """Legend of the colours: a dot and a label per hypothesis, sorted by id, in a grid."""
    rows = sorted(hypotheses, key=lambda row: row.id)
    shown = rows[: LEGEND_COLUMNS * LEGEND_ROWS]
    words = [f"{row.name} {row.state}, {row.size}" for row in shown]
    if len(rows) > len(shown):
        words[-1] += f" (+{len(rows) - len(shown)})"
    slots = np.arange(len(shown))
    column, row = slots % LEGEND_COLUMNS, slots // LEGEND_COLUMNS
    positions = np.stack([LEGEND_WIDTH * column, LEGEND_HEIGHT * row], axis=1).astype(np.float32)
    dots = positions - np.array((0.0, LEGEND_LIFT), np.float32)
    shades = np.array([row.colour for row in shown], np.uint8).reshape(-1, 3)
    return [
        points("legend/dots", dots, shades, 6.0),
        labels("legend/words", [legible(row.colour) for row in shown], positions, words),
    ]


def summary(snapshot: Snapshot) -> list[str]:
    """Format a snapshot as the lines of a page in Markdown."""
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
    # The colours are in the legend.
    return lines + markdown(snapshot.hypotheses[:ROWS], HYPOTHESIS_COLUMNS[1:])
