"""Figures 4.1 to 4.5: simulated scenes, drawn at some moments and over time."""

from functools import partial
from typing import Any

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .runs import SceneRuns, ViewRequest
from .study import (
    DEFAULT,
    Drawn,
    Row,
    Simulated,
    Study,
    alone,
    parameters,
    perfect_from,
    right_rows,
    row_of,
    rows_of_each,
)

# The thesis names 0.02 alone; the others are chosen so that the rows show what it says of them.
_CLAIMS = {
    0.005: "each trajectory is a hypothesis",
    0.01: "the object is right, the background is not",
    0.015: "takes many observations",
    0.02: "almost perfect, the best choice",
    0.08: "separated only after a long way",
}
_MOMENTS = ViewRequest((1.0, 5.0, 10.0), trail=3.0, affinity=True)
_SWITCHES = Simulated("fig4_1", {f"σ = {s:g}": thesis(s) for s in _CLAIMS}, 0.2, _MOMENTS)
_START, _END, _SWITCH = 10.0, 12.67, 0.01
_WEIGHED = {"equal weights": None, "v = 0.001": 0.001, "v = 0.1": 0.1}
_WEIGHTS = Simulated("fig4_3", {name: thesis(_SWITCH, v) for name, v in _WEIGHED.items()}, 1 / 15)
_TIMES = (1.0, 2.2, 3.4, 4.2, 6.2, 8.0)
_RESPAWNS = (2.0, 4.0, 6.0)
_RESPAWNING = Simulated("fig4_4", alone(thesis(0.01)), 1 / 15, ViewRequest(_TIMES, trail=1.5))


def draw_switches(study: Study) -> Drawn:
    """Figure 4.1: a row per σ, three moments and the affinities at t = 5; the default method below."""
    takes = study.simulated(_SWITCHES)
    figure = panels.new_figure(11.5, 2.75 * len(takes))
    axes = figure.subplots(len(takes), len(_SWITCHES.close.times) + 1)
    for row, (label, take) in zip(axes, takes.items(), strict=True):
        panels.scene_panels(row[:-1], take, _SWITCHES.scene, study)
        first = take.seeds[0]
        image = panels.affinity_panel(row[-1], first.views[1], first.names)
        style: dict[str, Any] = {"fontsize": 12, "fontweight": "bold", "va": "center", "ha": "right"}
        row[0].text(-0.24, 0.5, label, transform=row[0].transAxes, rotation=90, **style)
    panels.affinity_bar(figure, image, list(axes[:, -1]))
    panels.object_legend(figure, takes[DEFAULT].seeds[0].names)
    rows = rows_of_each("NMI is 1 from", takes, _CLAIMS.values(), _from_when)
    return Drawn(figure, rows, _switch_parameters(study))


def _from_when(take: SceneRuns) -> str:
    seconds = perfect_from(take)
    never = int(np.isnan(seconds).sum())
    if never == len(seconds):
        return "never"
    return f"{spread(seconds, 1)} s" + (f" (never in {never} of {len(seconds)} seeds)" if never else "")


def draw_switch_curves(study: Study) -> Drawn:
    """Figure 4.2: NMI over time for every σ and the default method."""
    takes = study.simulated(_SWITCHES)
    figure = panels.switch_curves(takes, study.options.seeds, 5.0, duration=10, legend="center right")
    return Drawn(figure, rows_of_each("mean NMI", takes, _CLAIMS.values()), _switch_parameters(study), takes)


def _switch_parameters(study: Study) -> dict[str, str]:
    return parameters(_SWITCHES, study, f"σ = {', '.join(f'{s:g}' for s in _CLAIMS)}, equal weights")


def draw_weights(study: Study) -> Drawn:
    """Figure 4.3: NMI over time for equal weights, a tiny v and a good one; the start enlarged."""
    takes = study.simulated(_WEIGHTS)
    figure = panels.new_figure(12, 4.6)
    whole, close = figure.subplots(1, 2, width_ratios=[3, 2])
    for k, (label, take) in enumerate(takes.items()):
        if label == DEFAULT:
            style: dict[str, Any] = {"colour": panels.DEFAULT_COLOUR, "width": 2.6, "order": 5}
        else:
            # The first two coincide: the dashes of the second let the first one through.
            hue = ("#e69f00", "#0072b2", "#d55e00")[k]
            style = {"colour": hue, "dashes": ("-", (0, (4, 3)), "-")[k], "order": 2 + k}
        for axes in (whole, close):
            panels.curve(axes, take, label, **style)
    panels.nmi_axes(whole, duration=_END, legend="upper left")
    panels.nmi_axes(close, duration=_END)
    close.set_xlim(_START - 0.1, _START + 1.3)
    close.set_title("the start of the motion", fontsize=10)
    whole.set_title(panels.spread_note(study.options.seeds), fontsize=10)
    for axes in (whole, close):
        axes.axvline(_START, color="0.5", linewidth=1, linestyle=":")
    described = f"σ = {_SWITCH:g}; equal weights, v = 0.001, v = 0.1"
    rows = rows_of_each(
        "NMI is 1, after the start",
        takes,
        (
            "the baseline",
            "not very different from equal weights",
            "sooner, although the effect is quite small",
        ),
        lambda take: f"{spread(perfect_from(take) - _START, 2)} s",
    )
    at_rest = (take.nmi[:, take.t < _START].max() for take in (takes["equal weights"], takes[DEFAULT]))
    resting = (f"{value:.3f}" for value in at_rest)
    rows.append(Row("largest NMI before the start", "nothing has moved", *resting))
    return Drawn(figure, rows, parameters(_WEIGHTS, study, described, drawn=False), takes)


def draw_respawning(study: Study) -> Drawn:
    """Figure 4.4: moments of the scene, tracks coloured by hypothesis."""
    takes = study.simulated(_RESPAWNING)
    figure = panels.scene_figure(study, _RESPAWNING, takes, (13, 5.4), (2, 3))
    rows = right_rows(takes, _TIMES, "most are assigned to the correct hypothesis")
    return Drawn(figure, rows, parameters(_RESPAWNING, study))


def draw_respawning_curves(study: Study) -> Drawn:
    """Figure 4.5: NMI over time; it drops when features are replaced."""
    takes = study.simulated(_RESPAWNING)
    figure = panels.new_figure(9.5, 4.6)
    axes = figure.subplots()
    (label, thesis_take), (_, default) = takes.items()
    panels.curve(axes, thesis_take, label, colour="#d55e00")
    panels.curve(axes, default, DEFAULT, colour=panels.DEFAULT_COLOUR, width=2.2, order=5)
    for t in _RESPAWNS:
        axes.axvline(t, color="0.5", linewidth=1, linestyle=":")
    panels.nmi_axes(axes, duration=8)
    axes.set_title(f"{panels.spread_note(study.options.seeds)}; dotted: features are replaced", fontsize=10)
    rows = []
    for t in _RESPAWNS:
        rows.append(row_of(f"NMI at t = {t:g} s", "drops", takes, partial(_nmi_at, t=t)))
        later = t + 4 / 3
        rows.append(row_of(f"NMI at t = {later:.2f} s", "slowly back to 1", takes, partial(_nmi_at, t=later)))
    rows.append(row_of("NMI .95 reached after a replacement in", "-", takes, _recovery))
    rows.append(row_of("mean NMI", "-", takes, lambda take: spread(take.mean_nmi())))
    return Drawn(figure, rows, parameters(_RESPAWNING, study, drawn=False), takes)


def _nmi_at(take: SceneRuns, t: float) -> str:
    return f"{np.nanmean(take.nmi[:, take.nearest(t)]):.3f}"


def _recovery(take: SceneRuns) -> str:
    """Mean time after a replacement until NMI is .95; the 2 s between two where it never is."""
    times = np.full((len(take.seeds), len(_RESPAWNS)), 2.0)
    for k, seed in enumerate(take.seeds):
        for j, t in enumerate(_RESPAWNS):
            seconds = seed.run.seconds
            good = seconds[(seconds >= t - 1e-6) & (seconds < t + 2 - 1e-6) & (seed.run.nmi >= 0.95)]
            times[k, j] = good[0] - t if len(good) else 2.0
    return f"{spread(times.mean(axis=1), 2)} s"
