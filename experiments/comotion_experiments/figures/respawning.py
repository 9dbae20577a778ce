"""Figures 4.4 and 4.5: translation, rotation, and features that are replaced every 2 s."""

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .colouring import Styles
from .figure import Drawn, Row
from .numbers import DEFAULT, parameters, right_at, summary
from .runs import SceneRuns, ViewRequest
from .study import Study, describe, spec_of

_SCENE, _PERIOD = "fig4_4", 1 / 15
_CONFIG = thesis(0.01)
_TIMES = (1.0, 2.2, 3.4, 4.2, 6.2, 8.0)
_RESPAWNS = (2.0, 4.0, 6.0)


def _takes(study: Study) -> tuple[SceneRuns, SceneRuns]:
    return study.both(_SCENE, _CONFIG, period=_PERIOD, close=ViewRequest(_TIMES, trail=1.5))


def draw_scenes(study: Study) -> Drawn:
    """Figure 4.4: moments of the scene, tracks coloured by hypothesis."""
    takes, spec = _takes(study), spec_of(_SCENE)
    figure = panels.new_figure(13, 5.4)
    for part, take in zip(panels.halves(figure, describe(_CONFIG), DEFAULT), takes, strict=True):
        first = take.seeds[0]
        styles = Styles(first)
        for axes, view in zip(part.subplots(2, 3).ravel(), first.views, strict=True):
            panels.scene_panel(axes, view, styles, spec, study.options.seeds[0])
    panels.object_legend(figure, takes[0].seeds[0].names)
    return Drawn(figure, _moment_rows(takes), parameters(_SCENE, _CONFIG, study, _PERIOD))


def draw_nmi(study: Study) -> Drawn:
    """Figure 4.5: NMI over time; it drops when features are replaced."""
    takes = _takes(study)
    figure = panels.new_figure(9.5, 4.6)
    axes = figure.subplots()
    panels.curve(axes, takes[0], describe(_CONFIG), colour="#d55e00")
    panels.curve(axes, takes[1], DEFAULT, colour=panels.DEFAULT_COLOUR, width=2.2, order=5)
    for t in _RESPAWNS:
        axes.axvline(t, color="0.5", linewidth=1, linestyle=":")
    panels.nmi_axes(axes, duration=8)
    axes.set_title(f"{panels.spread_note(study.options.seeds)}; dotted: features are replaced", fontsize=10)
    curves = {describe(_CONFIG): takes[0], DEFAULT: takes[1]}
    made_with = parameters(_SCENE, _CONFIG, study, _PERIOD)
    made_with.pop("drawn")
    return Drawn(figure, _rows(takes), made_with, curves, summary(curves))


def _moment_rows(takes: tuple[SceneRuns, SceneRuns]) -> list[Row]:
    said = "most are assigned to the correct hypothesis"
    return [
        Row(f"features in the right hypothesis at t = {t:g} s", said, *(right_at(take, k) for take in takes))
        for k, t in enumerate(_TIMES)
    ]


def _rows(takes: tuple[SceneRuns, SceneRuns]) -> list[Row]:
    rows = []
    for t in _RESPAWNS:
        rows.append(Row(f"NMI at t = {t:g} s", "drops", *(f"{take.nmi_at(t):.3f}" for take in takes)))
        later = t + 4 / 3
        after = (f"{take.nmi_at(later):.3f}" for take in takes)
        rows.append(Row(f"NMI at t = {later:.2f} s", "slowly back to 1", *after))
    recovery = [spread([_recovery(take, seed) for seed in range(len(take.seeds))], 2) for take in takes]
    rows.append(Row("NMI .95 reached after a replacement in", "-", *(f"{text} s" for text in recovery)))
    return [*rows, Row("mean NMI", "-", *(spread(take.mean_nmi()) for take in takes))]


def _recovery(take: SceneRuns, seed: int) -> float:
    """Mean time after a replacement until NMI is .95, seconds; the 2 s between two where it never is."""
    run, delays = take.seeds[seed], []
    for t in _RESPAWNS:
        after = (run.t >= t - 1e-6) & (run.t < t + 2 - 1e-6)
        good = np.flatnonzero(run.nmi[after] >= 0.95)
        delays.append(run.t[after][good[0]] - t if len(good) else 2.0)
    return float(np.mean(delays))
