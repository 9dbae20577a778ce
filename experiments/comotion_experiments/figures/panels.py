"""The kinds of panels that figures are made of, and their colours. Imports matplotlib when first drawn."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED
from comotion_schemas.colours import BACKGROUND, GREY, HUES, MARKERS, RGB, colour
from comotion_sources.simulator import SceneSpec, load_scene, simulate

from .. import plot
from ..plot import Rgb, unit
from ..trace import matched
from .runs import SceneRuns, View
from .study import DEFAULT, Simulated, Study

Size = tuple[float, float]
new_figure = partial(plot.new_figure, dpi=110)
DEFAULT_COLOUR = "black"
# Red is 0 and blue is 1 as in the thesis; safe for the colour-blind (ColorBrewer).
AFFINITY_COLOURS = "RdYlBu"
# Dark to light, so that the order can be seen without hues as well (viridis, less its pale end).
RAMP = ("#440154", "#31688e", "#1f9e89", "#e69f00", "#d55e00")
DASHES = ("-", (0, (6, 2)), (0, (2, 1.5)), (0, (7, 2, 1.5, 2)), (0, (4, 1, 1, 1, 1, 1)))


# The thesis's letters G, P, Y, B as the nearest hues of Okabe and Ito. R is its background: grey.
LETTERS: dict[str, RGB] = {
    "R": BACKGROUND,
    "G": (0, 158, 115),
    "P": (204, 121, 167),
    "Y": (240, 228, 66),
    "B": (0, 114, 178),
}
_SURPLUS = MARKERS[1:]


def object_colours(names: Mapping[int, str]) -> dict[int, RGB]:
    """Colour of every true object: of its letter if it has one, else of its number."""
    return {number: LETTERS.get(name, colour(number)) for number, name in names.items()}


class Styles:
    """How the hypotheses of one run are drawn, by the names of the true objects by number.

    `votes` are (hypothesis, object) -> tracks that they share, over the whole run; hypotheses are assigned to
    objects one to one by these.
    """

    def __init__(self, names: Mapping[int, str], votes: Mapping[tuple[int, int], int]) -> None:
        self.objects = object_colours(names)
        self._matched = matched(votes)
        self._free = [hue for hue in HUES if hue not in self.objects.values()] or list(HUES)
        others = sorted({h for h, _ in votes} - set(self._matched) - {UNDETERMINED})
        self._ranks = {h: rank for rank, h in enumerate(others)}

    def of(self, hypothesis: int) -> tuple[Rgb, str]:
        """Colour and marker of a hypothesis; a surplus one never has a circle."""
        if hypothesis == UNDETERMINED:
            return unit(GREY), "x"
        number = self._matched.get(hypothesis)
        if number is not None:
            return unit(self.objects.get(number, GREY)), "o"
        turn, place = divmod(self._ranks[hypothesis], len(self._free))
        return unit(self._free[place]), _SURPLUS[turn % len(_SURPLUS)]


def scene_figure(
    study: Study, how: Simulated, takes: Mapping[str, SceneRuns], size: Size, grid: tuple[int, int]
) -> Any:
    """Draw the moments of a scene, a take in each half, and the affinities in every second row, if any.

    `size` is in inches, `grid` has the rows and columns of a half.
    """
    figure = new_figure(*size)
    for part, (label, take) in zip(figure.subfigures(1, 2, wspace=0.03), takes.items(), strict=True):
        part.suptitle(label, fontsize=11, fontweight="bold")
        axes, first = part.subplots(*grid), take.seeds[0]
        scenes = axes[::2] if how.close.affinity else axes
        scene_panels(scenes.ravel(), take, how.scene, study)
        if how.close.affinity:
            below = axes[1::2].ravel()
            for panel, view in zip(below, first.views, strict=True):
                image = affinity_panel(panel, view, first.names)
            affinity_bar(part, image, list(below))
    object_legend(figure, takes[DEFAULT].seeds[0].names)
    return figure


def scene_panels(row: Sequence[Any], take: SceneRuns, scene: str, study: Study) -> None:
    """Draw the views of the first seed of a simulated scene, one in each of the axes."""
    first = take.seeds[0]
    styles = Styles(first.names, first.votes())
    for axes, view in zip(row, first.views, strict=False):
        _scene_panel(axes, view, styles, load_scene(scene), study.options.seeds[0])


def _scene_panel(axes: Any, view: View, styles: Styles, spec: SceneSpec, seed: int) -> None:
    """Draw trajectories in the colours of their hypotheses, over the outlines of the true objects."""
    from matplotlib.patches import Polygon

    for name, corners in _outlines(spec, seed, view.t):
        rgb = unit(LETTERS[name])
        axes.add_patch(Polygon(corners, facecolor=(*rgb, 0.10), edgecolor=(*rgb, 0.9), linewidth=1.0))
    draw_tracks(axes, view, styles, size=3.4)
    ticks = [0, 0.5, 1]
    axes.set(xlim=(-0.08, 1.14), ylim=(-0.08, 1.08), aspect="equal", xticks=ticks, yticks=ticks)
    axes.set_xlabel(f"x [{spec.unit}]", fontsize=7, labelpad=1)
    if axes.get_subplotspec().is_first_col():
        axes.set_ylabel(f"y [{spec.unit}]", fontsize=7, labelpad=1)
    axes.tick_params(labelsize=7, length=2)
    axes.set_title(f"t = {view.t:.3g} s", fontsize=9)


def draw_tracks(axes: Any, view: View, styles: Styles, size: float, edge: float = 0.3) -> None:
    """Draw every track as its trail and a point, in the style of its hypothesis."""
    labels = view.moment.hypotheses
    for label in np.unique(labels).tolist():
        members = np.flatnonzero(labels == label)
        rgb, shape = styles.of(label)
        axes.plot(*plot.broken(view.trails, members, 2), color=rgb, linewidth=0.9, alpha=0.75)
        ink, width = (rgb, 0.9) if shape == "x" else ("black", edge)
        style: dict[str, Any] = {"markeredgecolor": ink, "markeredgewidth": width}
        points = view.moment.positions[members].T
        axes.plot(*points, linestyle="", marker=shape, markersize=size, color=rgb, **style)


def _outlines(spec: SceneSpec, seed: int, t: float) -> list[tuple[str, NDArray[np.float64]]]:
    """Name and corners [4, 2] of every rectangle of a 2-D scene at a time."""
    (simulation,) = simulate(spec, seed=seed)
    squares = []
    for index, body in enumerate(spec.bodies):
        pose = simulation.poses(index, np.array([min(t, spec.duration)]))
        half = np.asarray(body.size, np.float64) / 2
        square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
        squares.append((body.name, square @ pose.rotations[0].T + pose.translations[0]))
    return squares


def affinity_panel(axes: Any, view: View, names: Mapping[int, str]) -> Any:
    """Draw an affinity matrix sorted by objects; answers with the image, for a colour bar."""
    image = axes.imshow(view.affinity, cmap=AFFINITY_COLOURS, vmin=0, vmax=1, interpolation="nearest")
    numbers, first, count = np.unique(view.affinity_objects, return_index=True, return_counts=True)
    for start in first[1:]:
        axes.axhline(start - 0.5, color="black", linewidth=0.5)
        axes.axvline(start - 0.5, color="black", linewidth=0.5)
    middles = first + (count - 1) / 2
    letters = [names.get(int(number), "?") for number in numbers]
    axes.set_xticks(middles, letters)
    axes.set_yticks(middles, letters)
    axes.tick_params(labelsize=8, length=0)
    axes.set_title(f"affinity, t = {view.t:.3g} s", fontsize=9)
    return image


def affinity_bar(figure: Any, image: Any, axes: Any) -> None:
    """Add the scale of affinities below some panels."""
    bar = figure.colorbar(image, ax=axes, location="bottom", shrink=0.5, aspect=40, pad=0.02)
    bar.set_label("affinity", fontsize=8)
    bar.ax.tick_params(labelsize=7)


def object_legend(figure: Any, names: Mapping[int, str]) -> None:
    """Explain colours and markers below a figure."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    colours = object_colours(names)
    handles: list[Any] = [
        Patch(facecolor=(*unit(colours[n]), 0.35), edgecolor=unit(colours[n]), label=name)
        for n, name in sorted(names.items())
    ]
    style: dict[str, Any] = {"linestyle": "", "color": "0.6", "markeredgecolor": "black", "markersize": 5}
    handles += [
        Line2D([], [], marker="o", label="hypothesis that matches the object of its colour", **style),
        Line2D([], [], marker="s", label="surplus hypothesis (any other marker)", **style),
        Line2D([], [], marker="x", linestyle="", color="0.4", markersize=5, label="undetermined"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)


def curve(axes: Any, take: SceneRuns, label: str, *, width: float = 1.8, order: int = 2, **how: Any) -> None:
    """Draw NMI over time: mean over seeds, and one standard deviation to both sides.

    `how` are a `colour` and `dashes`.
    """
    colour, dashes = how["colour"], how.get("dashes", "-")
    mean, spread = take.spread()
    axes.plot(take.t, mean, color=colour, linestyle=dashes, linewidth=width, label=label, zorder=order)
    if len(take.seeds) > 1:
        low, high = np.clip([mean - spread, mean + spread], 0, 1)
        axes.fill_between(take.t, low, high, color=colour, alpha=0.16, linewidth=0, zorder=order - 1)


def switch_curves(
    takes: Mapping[str, SceneRuns], seeds: Sequence[int], height: float, *, duration: float, **how: Any
) -> Any:
    """A figure of NMI over time for several σ of the thesis method, and for the default one, by their labels.

    `height` is in inches, `duration` in s; `how` are further arguments of :func:`nmi_axes`.
    """
    figure = new_figure(9.5, height)
    axes = figure.subplots()
    for k, (label, take) in enumerate(takes.items()):
        if label == DEFAULT:
            curve(axes, take, label, colour=DEFAULT_COLOUR, width=2.6, order=5)
        else:
            curve(axes, take, f"thesis, {label}", colour=RAMP[k], dashes=DASHES[k])
    nmi_axes(axes, duration=duration, **how)
    axes.set_title(spread_note(seeds), fontsize=10)
    return figure


def nmi_axes(axes: Any, *, duration: float, legend: str = "lower right", columns: int = 1) -> None:
    """Label the axes of NMI curves."""
    axes.set(xlim=(0, duration), ylim=(-0.02, 1.03), xlabel="t [s]", ylabel="normalized mutual information")
    axes.grid(visible=True, alpha=0.3)
    axes.legend(loc=legend, fontsize=8.5, ncols=columns, framealpha=0.9)


def spread_note(seeds: Sequence[int]) -> str:
    """Say what curves and bands are."""
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    return f"mean over {len(seeds)} seeds, band: ± 1 standard deviation"
