"""The results as a table, in a terminal and in Markdown, as plain values, and as a picture."""

import io
import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from ..plot import new_figure
from ..tables import Table, means, number
from . import image_report
from .catalogue import ALL, FAMILIES
from .experiment import DEFAULT, THESIS, Results
from .motion import Array

_PICTURES_A_ROW = 5
_PALETTE = 64
_WIDTH = 110
_COLOURS = {DEFAULT: "#0072b2", THESIS: "#d55e00"}

# Field of the figures, title, digits.
_COLUMNS = (
    ("nmi_apart", "NMI", 3),
    ("all_bodies", "all bodies", 3),
    ("nmi", "by body", 3),
    ("delay", "delay", 2),
    ("healing", "healing", 2),
    ("healed_in_1s", "in 1 s", 2),
    ("kept", "kept", 2),
    ("wrong", "wrong", 2),
    ("ids", "ids", 2),
    ("spurious", "spurious", 1),
    ("true", "true", 1),
    ("switches", "switches", 1),
    ("hypotheses", "K", 2),
    ("bodies", "K true", 2),
    ("over", "over", 2),
    ("ms", "ms", 1),
)


def families_of(results: Results) -> list[str]:
    """Names of the families that were run, in the order of the catalogue."""
    ran = {o.family for o in results.outcomes}
    return [name for name in FAMILIES if name in ran]


def tables(results: Results) -> list[Table]:
    """For a terminal: a table of scenes and one of image sequences, those that were run."""
    shown = [_table(results)] if results.outcomes else []
    return [*shown, image_report.table(results.images)] if results.images else shown


def _table(results: Results) -> Table:
    drawn = Table(("family", "method", *(title for _, title, _ in _COLUMNS)), words=2)
    for family in families_of(results):
        for method in results.methods:
            row = means([o.figures for o in results.of(family, method)])
            drawn.add(family, method, *(number(row[name], digits) for name, _, digits in _COLUMNS))
    return drawn


def traces(results: Results) -> str:
    """NMI of every update of every scene: time, NMI, NMI with bodies as one until apart, hypotheses."""
    lines = []
    for outcome in results.outcomes:
        for scene, trace in enumerate(outcome.traces):
            which = f"{outcome.family}, {outcome.method}, seed {outcome.seed}, scene {scene}"
            lines.append(f"{which}: t NMI/apart K")
            rows = zip(trace.seconds, trace.nmi, trace.nmi_apart, trace.hypotheses, strict=True)
            cells = [f"{t:6.2f} {nmi:.2f}/{apart:.2f} {count:2d}" for t, nmi, apart, count in rows]
            lines += ["  " + " | ".join(cells[k : k + 8]) for k in range(0, len(cells), 8)]
    return "\n".join(lines)


def as_json(results: Results) -> Any:
    """Everything but the traces, for JSON."""
    images = [
        {"family": o.family, "seed": o.seed, **vars(o.figures), "errors": o.errors} for o in results.images
    ]
    runs = [
        {"family": o.family, "method": o.method, "seed": o.seed, **vars(o.figures)} for o in results.outcomes
    ]
    return {"seeds": results.seeds, "images": images, "runs": runs}


def markdown(results: Results, picture: str) -> str:
    """For a document; `picture` is the name of the picture beside it."""
    parts = [_head(results), *([f"![NMI over time]({picture})"] if results.outcomes else [])]
    groups = dict.fromkeys(FAMILIES[name].group for name in families_of(results))
    parts += [_group(results, group) for group in groups]
    parts += [image_report.markdown(results.images)] if results.images else []
    return "\n\n".join(parts) + "\n"


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

# The terminal and the JSON have all figures, the page those that most others follow from.
_MARKDOWN = (
    ("nmi_apart", "NMI", 3),
    ("delay", "delay, s", 2),
    ("healing", "healing, s", 1),
    ("kept", "kept", 2),
    ("ids", "ids", 1),
    ("spurious", "spurious", 0),
)

_OF_BOTH = {"nmi_apart"}
_BOTH = " of the default method; NMI also of the thesis method"


def _head(results: Results) -> str:
    listed = ", ".join(str(seed) for seed in results.seeds)
    odd = all(seed % 2 for seed in results.seeds)
    role = "even ones are for development" if odd else "not all odd: those that are even are for development"
    ran = {o.family for o in results.outcomes} | {o.family for o in results.images}
    opening = _OPENING.format(
        seeds=f"Seed{'s' if len(results.seeds) > 1 else ''} {listed} ({role}).",
        part="" if ran == set(ALL) else f" Here are {len(ran)} of {len(ALL)} families.",
        both=_BOTH if len(results.methods) > 1 else "",
    )
    return "\n\n".join(["# Stress", textwrap.fill(" ".join(opening.split()), _WIDTH), _TERMS])


def _group(results: Results, group: str) -> str:
    names = [name for name in families_of(results) if FAMILIES[name].group == group]
    rows = {
        name: [means([o.figures for o in results.of(name, method)]) for method in results.methods]
        for name in names
    }
    # A column without a value in the whole group says nothing.
    columns = [c for c in _MARKDOWN if any(not math.isnan(r[c[0]]) for row in rows.values() for r in row)]
    drawn = Table(("family", "what happens", *(title for _, title, _ in columns)), words=2)
    for name, row in rows.items():
        cells = (
            " / ".join(_short(r[key], digits) for r in (row if key in _OF_BOTH else row[:1]))
            for key, _, digits in columns
        )
        drawn.add(f"`{name}`", FAMILIES[name].title, *cells)
    return f"## {group[0].upper()}{group[1:]}\n\n{drawn.markdown()}"


def _short(value: float, digits: int) -> str:
    """Write a number below 1 without the zero."""
    text = number(value, digits)
    return text[1:] if text.startswith("0.") else text


def save_picture(path: Path, results: Results) -> None:
    """Draw NMI over time, mean over runs, a small picture for each family of scenes of equal length."""
    from PIL import Image

    names = [name for name in families_of(results) if not FAMILIES[name].slow]
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
    length = min(len(trace.nmi) for trace in traces)
    seconds = np.array(traces[0].seconds[:length]) - traces[0].seconds[0]
    # While everything is covered there is nothing to score.
    nmi = np.ma.masked_invalid([trace.nmi_apart[:length] for trace in traces])
    return seconds, nmi.mean(axis=0).filled(np.nan)
