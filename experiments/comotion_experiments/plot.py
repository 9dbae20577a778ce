"""Plot of a run: tracks coloured by hypothesis and by true object, and NMI over time.

Needs the extra ``plot`` (matplotlib), which is imported only when a picture is drawn.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, HypothesisUpdate
from comotion_schemas.colours import BACKGROUND, COLOURS, GREY, HUES, RGB, Palette, colour, marker
from comotion_schemas.errors import KnownError

from .trace import Moment, Trace, main_space, matched, moment_of, trails_of

if TYPE_CHECKING:
    from comotion_clients import evaluate as live

    from . import offline

__all__ = ["Trace", "save_plot"]

Scored: TypeAlias = "offline.Run | live.LiveRun"

PANELS = 3
Rgb = tuple[float, float, float]
TRAIL_S = 1.0
_LEGEND_LIMIT = 8


def new_figure(width: float, height: float, *, dpi: int = 100, layout: Any = "constrained") -> Any:
    """Make an empty figure of a size in inches; it needs no display.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def save_plot(path: Path, title: str, trace: Trace, run: Scored) -> None:
    """Draw the updates of a run to a file under a title; the suffix determines the format.

    Three moments of the run, the tracks coloured by hypothesis and, below, by true object; then
    NMI over time, or the number of hypotheses where there is no truth. Of several coordinate
    spaces the one with most tracks is drawn. The folder of the file is made if need be.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    ValueError
        If there is no update with a track.
    """
    figure = _RunFigure(trace, run).draw(title)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _colours(updates: Sequence[HypothesisUpdate]) -> list[dict[int, RGB]]:
    """Colours of the hypotheses of every update."""
    palette, colours = Palette(), []
    for update in updates:
        palette.see(update.hypotheses)
        colours.append({h.id: palette.colour(h.id) for h in update.hypotheses} | {UNDETERMINED: GREY})
    return colours


def object_colours(moment: Moment, colours: Mapping[int, RGB]) -> dict[int, Rgb]:
    """Colour of each true object: that of the hypothesis it matches best, so that errors are visible.

    `colours` are those of the hypotheses.
    """
    labels, objects = moment.hypotheses, moment.objects
    scored = (objects >= 0) & (labels != UNDETERMINED)
    votes = Counter(zip(labels[scored].tolist(), objects[scored].tolist(), strict=True))
    chosen = {number: colours[hypothesis] for hypothesis, number in matched(votes).items()}
    free = [hue for hue in COLOURS if hue not in set(colours.values())]
    for number in np.unique(objects[objects >= 0]).tolist():
        if number not in chosen:
            chosen[number] = free.pop(0) if free else colour(number)
    return {number: unit(rgb) for number, rgb in chosen.items()}


def unit(rgb: RGB) -> Rgb:
    """Colour in 0..1, as matplotlib takes it."""
    return rgb[0] / 255, rgb[1] / 255, rgb[2] / 255


class _RunFigure:
    def __init__(self, trace: Trace, run: Scored) -> None:
        space = main_space(trace.updates, run.observed.spaces)
        if space is None:
            raise KnownError("there is nothing to plot: no update lists a track")
        self._run, self._space = run, space
        self._moments = [moment_of(update, run.truth, run.observed.spaces, space) for update in trace.updates]
        self._colours = _colours(trace.updates)
        self._has_truth = any((moment.objects >= 0).any() for moment in self._moments)
        filled = [m.stamp_ns for m in self._moments if m.tracks]
        self._start_ns = min([*filled, *(score.stamp_ns for score in run.scores if score.scored)])
        self._limits = _limits([m.positions for m in self._moments])

    def draw(self, title: str) -> Any:
        from matplotlib.layout_engine import ConstrainedLayoutEngine

        rows = 2 if self._has_truth else 1
        # The layout does not see the labels of 3-D axes.
        layout = ConstrainedLayoutEngine(hspace=0.02 if self._space.dim == 2 else 0.08)
        self._figure = new_figure(12, 3.2 * (rows + 1), layout=layout)
        self._figure.suptitle(title, fontsize=14)
        grid = self._figure.add_gridspec(rows + 1, PANELS, height_ratios=[*[3] * rows, 2])
        # Moments with tracks, evenly spread over the run, including its end.
        filled = [k for k, moment in enumerate(self._moments) if moment.tracks]
        chosen = [filled[round(k)] for k in np.linspace(0, len(filled) - 1, PANELS + 1)[1:]]
        for column, index in enumerate(chosen):
            t = self._seconds(self._moments[index].stamp_ns)
            self._panel(grid[0, column], index, f"hypotheses, t = {t:.1f} s", truth=False)
            if self._has_truth:
                self._panel(grid[1, column], index, "truth", truth=True)
        self._curve(self._figure.add_subplot(grid[rows, :]), chosen)
        return self._figure

    def _seconds(self, stamp_ns: int) -> float:
        return (stamp_ns - self._start_ns) / 1e9

    def _panel(self, cell: Any, index: int, title: str, *, truth: bool) -> None:
        flat = self._space.dim == 2
        axes = self._figure.add_subplot(cell, **({} if flat else {"projection": "3d"}))
        moment, shown = self._moments[index], self._colours[index]
        late = [m for m in self._moments[: index + 1] if m.stamp_ns >= moment.stamp_ns - TRAIL_S * 1e9]
        trails = trails_of(moment, [(m.tracks, m.positions) for m in late])
        labels = moment.objects if truth else moment.hypotheses
        objects = object_colours(moment, shown) if truth else {}
        for label in np.unique(labels).tolist():
            members = np.flatnonzero(labels == label)
            if not truth:
                rgb, shape, name = unit(shown[label]), marker(label), f"{label}"
                name = "undetermined" if label == UNDETERMINED else name
                name += f"{' at rest' if shown[label] == BACKGROUND else ''} ({len(members)})"
            elif label < 0:
                rgb, shape, name = unit(GREY), "x", "not scored"
            else:
                rgb, shape, name = objects[label], "o", self._run.truth.names.get(label, f"object {label}")
            axes.plot(*broken(trails, members, self._space.dim), color=rgb, linewidth=0.8, alpha=0.55)
            points = moment.positions[members].T
            axes.plot(*points, linestyle="", marker=shape, markersize=4.5, color=rgb, label=name)
        axes.set_title(title, fontsize=11)
        self._frame(axes)
        self._legend(axes)

    def _frame(self, axes: Any) -> None:
        names = "xyz"[: self._space.dim]
        widest = max(high - low for low, high in self._limits)
        for name, (low, high) in zip(names, self._limits, strict=True):
            getattr(axes, f"set_{name}lim")(low, high)
            getattr(axes, f"set_{name}label")(f"{name} [{self._space.unit}]", fontsize=9)
            axes.locator_params(axis=name, nbins=max(2, round(5 * (high - low) / widest)))
        axes.tick_params(labelsize=8)
        if self._space.dim == 3:
            axes.set_box_aspect([high - low for low, high in self._limits], zoom=0.85)
            return
        axes.set_aspect("equal")
        if self._space.unit == "px":
            axes.invert_yaxis()

    def _legend(self, axes: Any) -> None:
        handles, names = axes.get_legend_handles_labels()
        if len(names) > _LEGEND_LIMIT:
            names = [*names[: _LEGEND_LIMIT - 1], f"... {len(names)} in all"]
        # Beside a plane, where it hides nothing; the corner of a 3-D view is empty.
        beside = (1.01, 1.0) if self._space.dim == 2 else None
        style = {"fontsize": 7, "framealpha": 0.7, "handletextpad": 0.2}
        axes.legend(handles[: len(names)], names, loc="upper left", bbox_to_anchor=beside, **style)

    def _curve(self, axes: Any, chosen: Sequence[int]) -> None:
        if self._has_truth:
            curve = [(score.stamp_ns, score.nmi) for score in self._run.scores]
            axes.set(ylim=(-0.03, 1.05), ylabel="NMI")
            title = f"NMI against the truth: mean {np.nanmean([nmi for _, nmi in curve]):.3f}"
        else:
            shown = [(m.stamp_ns, m.hypotheses[m.hypotheses != UNDETERMINED]) for m in self._moments]
            curve = [(stamp_ns, float(len(np.unique(labels)))) for stamp_ns, labels in shown]
            axes.set(ylabel="hypotheses")
            title = "number of hypotheses (no truth)"
        axes.set_title(title, fontsize=11)
        times, values = [self._seconds(stamp_ns) for stamp_ns, _ in curve], [value for _, value in curve]
        axes.plot(times, values, color=unit(HUES[0]), linewidth=1.4)
        for t in (self._seconds(self._moments[index].stamp_ns) for index in chosen):
            axes.axvline(t, color="0.6", linewidth=0.8, dashes=(4, 3))
        axes.set_xlabel("t [s]")
        axes.grid(visible=True, alpha=0.3)


def _limits(clouds: Sequence[NDArray[np.float32]]) -> list[tuple[float, float]]:
    """Bounds per axis that contain 99 % of the points, with a margin."""
    points = np.concatenate(clouds)
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    margin = 0.06 * max(float((high - low).max()), 1e-6)
    return [(float(a) - margin, float(b) + margin) for a, b in zip(low, high, strict=True)]


def broken(
    trails: Sequence[NDArray[np.float32]], members: NDArray[np.intp], dim: int
) -> Iterator[NDArray[np.float32]]:
    """Join trails to one line with gaps, one array per axis; one line is drawn much faster than many."""
    gap = np.full((1, dim), np.nan, np.float32)
    pieces = [piece for member in members.tolist() for piece in (trails[member], gap)]
    yield from np.concatenate(pieces).T
