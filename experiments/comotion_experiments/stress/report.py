"""The results as a table, in a terminal and in Markdown, as plain values, and as a picture."""

import io
import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from ..plot import new_figure
from ..tables import Table, document, means
from .catalogue import FAMILIES, Family
from .columns import IMAGE_COLUMNS, PAGE_COLUMNS, SCENE_COLUMNS
from .experiment import DEFAULT, METHODS, THESIS, Results
from .motion import Array

_PICTURES_A_ROW = 5
_PALETTE = 64
_WIDTH = 110
_COLOURS = {DEFAULT: "#0072b2", THESIS: "#d55e00"}


def _rows(results: Results, family: Family) -> list[dict[str, float]]:
    """Means over the seeds of a family, a row for each method that was run on it."""
    runs = (results.of(family.name, method) for method in METHODS)
    return [means([o.figures for o in outcomes]) for outcomes in runs if outcomes]


def tables(results: Results) -> list[Table]:
    """For a terminal: a table of scenes and one of image sequences, those that were run."""
    scenes = Table(("family", "method", *(column.title for column in SCENE_COLUMNS)), words=2)
    for family in (family for family in results.families if not family.of_images):
        for method, row in zip(results.methods, _rows(results, family), strict=True):
            scenes.add(family.name, method, *(column.of(row) for column in SCENE_COLUMNS))
    return [table for table in (scenes, _images(results)) if table.rows]


def _images(results: Results) -> Table:
    table = Table(("family", "what is seen", *(column.title for column in IMAGE_COLUMNS)), words=2)
    for family in (family for family in results.families if family.of_images):
        (row,) = _rows(results, family)
        table.add(f"`{family.name}`", family.title, *(column.of(row) for column in IMAGE_COLUMNS))
    return table


def traces(results: Results) -> str:
    """NMI of every update of every scene: time, NMI, NMI with bodies as one until apart, hypotheses."""
    lines = []
    for outcome in results.outcomes:
        for scene, trace in enumerate(outcome.traces):
            which = f"{outcome.family}, {outcome.method}, seed {outcome.seed}, scene {scene}"
            lines.append(f"{which}: t NMI/apart K")
            cells = [
                f"{t:6.2f} {nmi:.2f}/{apart:.2f} {count:2.0f}" for t, nmi, apart, count in trace.tolist()
            ]
            lines += ["  " + " | ".join(cells[k : k + 8]) for k in range(0, len(cells), 8)]
    return "\n".join(lines)


def as_json(results: Results) -> Any:
    """Everything but the traces, for JSON."""
    images = [
        {"family": o.family, "seed": o.seed, **o.figures, "errors": o.errors}
        for o in results.outcomes
        if o.errors
    ]
    runs = [
        {"family": o.family, "method": o.method, "seed": o.seed, **o.figures}
        for o in results.outcomes
        if o.traces
    ]
    return {"seeds": results.seeds, "images": images, "runs": runs}


def markdown(results: Results, picture: str) -> str:
    """For a document; `picture` is the name of the picture beside it."""
    parts: list[str | Table] = [*_head(results), f"![NMI over time]({picture})" if results.methods else ""]
    for group in dict.fromkeys(family.group for family in results.families):
        parts += [f"## {group[0].upper()}{group[1:]}", *_group(results, group)]
    return document(parts)


_OPENING = """Made by `comotion dev reproduce stress`. Scenes that are not clean: trackers restart,
features drift, bodies rest. {seeds}{part} All scenes are made up; the parameters of each family are in
`comotion_experiments.stress`. The thesis method has equal weights and the σ_switch that suits the scene's
noise. Every cell is a mean over seeds{both}."""

_TERMS = """\
- **NMI** (4.1) over every track observed at an update, all updates; bodies count as one until they have moved
  apart by five sigma of the noise (root mean square over their features).
- **delay**: seconds from apart to a hypothesis of its own, a body that never gets one with all the time left.
- **healing**: seconds from an event (what was lost is back) until the NMI is .95 and stays so in the mean of
  3 s. **kept**: share of bodies that kept their id.
- **ids**: hypotheses that held most tracks of an object over the run, mean over objects.
- **spurious**: events a minute beyond the true ones."""

_OF_IMAGES = """\
Bodies with depth seen by a perspective camera for 2 to 3 s, 0.3 px of noise, six sequences a family and seed;
the pixel method with K unknown, one update at the end. **Error**: misclassified features; those without a
hypothesis are wrong. **K given**: spectral clustering of shape interaction, which is given K. **one**: all
features are one object."""

_OF_BOTH = {"nmi_apart"}
_BOTH = " of the default method; NMI also of the thesis method"


def _head(results: Results) -> list[str]:
    listed = ", ".join(str(seed) for seed in results.seeds)
    odd = all(seed % 2 for seed in results.seeds)
    role = "even ones are for development" if odd else "not all odd: those that are even are for development"
    ran = len(results.families)
    opening = _OPENING.format(
        seeds=f"Seed{'s' if len(results.seeds) > 1 else ''} {listed} ({role}).",
        part="" if ran == len(FAMILIES) else f" Here are {ran} of {len(FAMILIES)} families.",
        both=_BOTH if len(results.methods) > 1 else "",
    )
    return ["# Stress", textwrap.fill(" ".join(opening.split()), _WIDTH), _TERMS]


def _group(results: Results, group: str) -> list[str | Table]:
    families = [family for family in results.families if family.group == group]
    if families[0].of_images:
        return [_OF_IMAGES, _images(results)]
    rows = [_rows(results, family) for family in families]
    # A column without a value in the whole group says nothing.
    columns = [c for c in PAGE_COLUMNS if any(not math.isnan(r[c.key]) for row in rows for r in row)]
    table = Table(("family", "what happens", *(column.title for column in columns)), words=2)
    for family, row in zip(families, rows, strict=True):
        cells = (
            " / ".join(_short(column.of(r)) for r in (row if column.key in _OF_BOTH else row[:1]))
            for column in columns
        )
        table.add(f"`{family.name}`", family.title, *cells)
    return [table]


def _short(text: str) -> str:
    """Write a number below 1 without the zero."""
    return text[1:] if text.startswith("0.") else text


def save_picture(path: Path, results: Results) -> None:
    """Draw NMI over time, mean over runs, a small picture for each family of scenes of equal length."""
    from PIL import Image

    names = [family.name for family in results.families if not (family.slow or family.of_images)]
    rows = max(math.ceil(len(names) / _PICTURES_A_ROW), 1)
    figure = new_figure(2.4 * _PICTURES_A_ROW, 1.5 * rows)
    for place, name in enumerate(names, start=1):
        axes = figure.add_subplot(rows, _PICTURES_A_ROW, place)
        for method in results.methods:
            seconds, nmi = _mean_trace(results, name, method)
            axes.plot(seconds, nmi, color=_COLOURS[method], linewidth=1, label=method)
        axes.set_title(name, fontsize=8)
        axes.set_ylim(-0.02, 1.05)
        axes.tick_params(labelsize=6)
        if place == 1:
            axes.legend(fontsize=6)
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    # With a palette a picture of forty families has a third of the bytes.
    Image.open(drawn).convert("RGB").quantize(_PALETTE).save(path, optimize=True)


def _mean_trace(results: Results, family: str, method: str) -> tuple[Array, Array]:
    """Seconds since the first update and NMI (apart), mean over scenes and seeds, float64 [updates]."""
    traces = [trace for outcome in results.of(family, method) for trace in outcome.traces]
    length = min(map(len, traces))
    seconds = traces[0][:length, 0] - traces[0][0, 0]
    # While everything is covered there is nothing to score.
    nmi = np.ma.masked_invalid([trace[:length, 2] for trace in traces])
    return seconds, nmi.mean(axis=0).filled(np.nan)
