"""The results as a table, in a terminal and in Markdown, as plain values, and as a picture."""

import io
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..plot import new_figure
from ..tables import Column, Table, filled, means
from .catalogue import FAMILIES, Family
from .experiment import DEFAULT, METHODS, THESIS, Outcome
from .motion import Array

Outcomes: TypeAlias = Sequence[Outcome]
_PICTURES_A_ROW = 5
_PALETTE = 64
_WIDTH = 110
_COLOURS = {DEFAULT: "#0072b2", THESIS: "#d55e00"}
# NaN where a metric does not apply.
SCENE_COLUMNS = (
    Column("nmi_apart", "NMI", 3),  # mean, bodies as one until they have moved apart by five sigma
    Column("all_bodies", "all bodies", 3),  # from a second after all bodies are apart
    Column("nmi", "by body", 3),  # against the true bodies
    Column("delay", "delay", 2),  # s from apart to a hypothesis of its own, mean over bodies
    Column("healing", "healing", 2),  # s after an event until right again, mean over events
    Column("healed_in_1s", "in 1 s", 2),  # share of events with at most 1 s
    Column("kept", "kept", 2),  # share of bodies with the same id before and after an event
    Column("wrong", "wrong", 2),  # 1 where the mean NMI (apart) after the first 5 s is below .95
    Column("ids", "ids", 2),  # an object over the run
    Column("spurious", "spurious", 1),  # events a minute beyond the true ones
    Column("true", "true", 1),  # events a minute
    Column("switches", "switches", 1),  # tracks with another hypothesis than an update before, per 100
    Column("hypotheses", "K", 2),  # mean number of confirmed ones
    Column("bodies", "K true", 2),  # mean number of bodies apart
    Column("over", "over", 2),  # share of the updates with more of the former
    Column("ms", "ms", 1),  # median time of an update
)
# The terminal and the JSON have all metrics, the page those that most others follow from.
PAGE_COLUMNS = (
    Column("nmi_apart", "NMI", 3),
    Column("delay", "delay, s", 2),
    Column("healing", "healing, s", 1),
    Column("kept", "kept", 2),
    Column("ids", "ids", 1),
    Column("spurious", "spurious", 0),
)
IMAGE_COLUMNS = (
    Column("error", "error, %", 1),  # misclassified features; undetermined ones are wrong
    Column("exact", "K exact, %", 0, 100.0),  # share of sequences with the right number of objects
    Column("over", "K over, %", 0, 100.0),  # with more
    Column("under", "K under, %", 0, 100.0),  # with fewer
    Column("nmi", "NMI", 3),
    Column("given", "K given, %", 1),  # error of spectral clustering of shape interaction, with K given
    Column("one", "one, %", 1),  # error of one object for all
)


def _families(outcomes: Outcomes, *, of_images: bool = False) -> list[Family]:
    """Those that were run, in the order of the catalogue."""
    ran = {o.family for o in outcomes}
    return [f for name, f in FAMILIES.items() if name in ran and f.of_images == of_images]


def _methods(outcomes: Outcomes) -> list[str]:
    """The methods that were run on scenes, in order."""
    return [m for m in METHODS if any(o.method == m and o.traces for o in outcomes)]


def _rows(outcomes: Outcomes, family: Family) -> list[dict[str, float]]:
    """Means over the seeds of a family, a row for each method that was run on it."""
    runs = ([o.figures for o in outcomes if (o.family, o.method) == (family.name, m)] for m in METHODS)
    return [means(figures) for figures in runs if figures]


def tables(outcomes: Outcomes) -> list[Table]:
    """For a terminal: a table of scenes and one of image sequences, those that were run."""
    scenes = Table(("family", "method", *(column.title for column in SCENE_COLUMNS)), words=2)
    for family in _families(outcomes):
        for method, row in zip(_methods(outcomes), _rows(outcomes, family), strict=True):
            scenes.add(family.name, method, *(column.of(row) for column in SCENE_COLUMNS))
    return [table for table in (scenes, _images(outcomes)) if table.rows]


def _images(outcomes: Outcomes) -> Table:
    table = Table(("family", "what is seen", *(column.title for column in IMAGE_COLUMNS)), words=2)
    for family in _families(outcomes, of_images=True):
        (row,) = _rows(outcomes, family)
        table.add(f"`{family.name}`", family.title, *(column.of(row) for column in IMAGE_COLUMNS))
    return table


def traces(outcomes: Outcomes) -> str:
    """NMI of every update of every scene: time, NMI, NMI with bodies as one until apart, hypotheses."""
    lines = []
    for o in outcomes:
        for scene, trace in enumerate(o.traces):
            lines.append(f"{o.family}, {o.method}, seed {o.seed}, scene {scene}: t NMI/apart K")
            cells = [
                f"{t:6.2f} {nmi:.2f}/{apart:.2f} {count:2.0f}" for t, nmi, apart, count in trace.tolist()
            ]
            lines += ["  " + " | ".join(cells[k : k + 8]) for k in range(0, len(cells), 8)]
    return "\n".join(lines)


def as_json(outcomes: Outcomes) -> Any:
    """Everything but the traces, for JSON."""
    images: list[Any] = []
    runs: list[Any] = []
    for o in outcomes:
        if o.errors:
            images.append({"family": o.family, "seed": o.seed, **o.figures, "errors": o.errors})
        else:
            runs.append({"family": o.family, "method": o.method, "seed": o.seed, **o.figures})
    return {"seeds": _seeds(outcomes), "images": images, "runs": runs}


def _seeds(outcomes: Outcomes) -> list[int]:
    return list(dict.fromkeys(o.seed for o in outcomes))


_OPENING = """Made by `comotion dev reproduce stress`. Scenes that are not clean: trackers restart,
features drift, bodies rest. {seeds}{part} All scenes are made up; the parameters of each family are in
`comotion_experiments.stress`. The thesis method has equal weights and the σ_switch that suits the scene's
noise. Every cell is a mean over seeds{both}."""

_OF_BOTH = {"nmi_apart"}
_BOTH = " of the default method; NMI also of the thesis method"


def markdown(outcomes: Outcomes, picture: str) -> str:
    """For a document; `picture` is the name of the picture beside it."""
    seeds, methods, images = _seeds(outcomes), _methods(outcomes), _images(outcomes)
    listed = ", ".join(map(str, seeds))
    odd = all(seed % 2 for seed in seeds)
    role = "even ones are for development" if odd else "not all odd: those that are even are for development"
    families = _families(outcomes)
    ran = len(families) + len(images.rows)
    opening = _OPENING.format(
        seeds=f"Seed{'s' if len(seeds) > 1 else ''} {listed} ({role}).",
        part="" if ran == len(FAMILIES) else f" Here are {ran} of {len(FAMILIES)} families.",
        both=_BOTH if len(methods) > 1 else "",
    )
    parts: dict[str, str | Table] = {
        "opening": textwrap.fill(" ".join(opening.split()), _WIDTH),
        "picture": f"![NMI over time]({picture})" if methods else "",
    }
    for group in dict.fromkeys(family.group for family in families):
        some = [family for family in families if family.group == group]
        parts[group.replace(" ", "_")] = _group(outcomes, some)
    return filled(Path(__file__).with_name("page.md"), parts | ({"images": images} if images.rows else {}))


def _group(outcomes: Outcomes, families: Sequence[Family]) -> Table:
    rows = [_rows(outcomes, family) for family in families]
    # A column without a value in the whole group says nothing.
    columns = [c for c in PAGE_COLUMNS if any(not math.isnan(r[c.key]) for row in rows for r in row)]
    table = Table(("family", "what happens", *(column.title for column in columns)), words=2)
    for family, row in zip(families, rows, strict=True):
        cells = (
            " / ".join(_short(column.of(r)) for r in (row if column.key in _OF_BOTH else row[:1]))
            for column in columns
        )
        table.add(f"`{family.name}`", family.title, *cells)
    return table


def _short(text: str) -> str:
    """Write a number below 1 without the zero."""
    return text[1:] if text.startswith("0.") else text


def save_picture(path: Path, outcomes: Outcomes) -> None:
    """Draw NMI over time, mean over runs, a small picture for each family of scenes of equal length."""
    from PIL import Image

    names = [family.name for family in _families(outcomes) if not family.slow]
    rows = max(math.ceil(len(names) / _PICTURES_A_ROW), 1)
    figure = new_figure(2.4 * _PICTURES_A_ROW, 1.5 * rows)
    for place, name in enumerate(names, start=1):
        axes = figure.add_subplot(rows, _PICTURES_A_ROW, place)
        for method in _methods(outcomes):
            runs = [trace for o in outcomes if (o.family, o.method) == (name, method) for trace in o.traces]
            axes.plot(*_mean_trace(runs), color=_COLOURS[method], linewidth=1, label=method)
        axes.set_title(name, fontsize=8)
        axes.set_ylim(-0.02, 1.05)
        axes.tick_params(labelsize=6)
        if place == 1:
            axes.legend(fontsize=6)
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    # With a palette a picture of forty families has a third of the bytes.
    Image.open(drawn).convert("RGB").quantize(_PALETTE).save(path, optimize=True)


def _mean_trace(traces: Sequence[Array]) -> tuple[Array, Array]:
    """Seconds since the first update and NMI (apart), mean over scenes and seeds, float64 [updates]."""
    length = min(map(len, traces))
    seconds = traces[0][:length, 0] - traces[0][0, 0]
    # While everything is covered there is nothing to score.
    nmi = np.ma.masked_invalid([trace[:length, 2] for trace in traces])
    return seconds, nmi.mean(axis=0).filled(np.nan)
