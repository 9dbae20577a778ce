"""Figures 4.1 and 4.2: the effect of γ, chosen by the standard deviation where affinity switches."""

from ..offline import thesis
from ..tables import spread
from . import panels
from .colouring import Styles
from .figure import Drawn, Row
from .numbers import DEFAULT, format_times, parameters, perfect_from, summary
from .runs import SceneRuns, ViewRequest
from .study import Study, spec_of

_SCENE, _PERIOD = "fig4_1", 0.2
# The thesis names 0.02 alone; the others are chosen so that the rows show what it says of them.
SWITCHES = (0.005, 0.01, 0.015, 0.02, 0.08)
_TIMES = (1.0, 5.0, 10.0)
_SAID = {
    0.005: "each trajectory is a hypothesis",
    0.01: "the object is right, the background is not",
    0.015: "takes many observations",
    0.02: "almost perfect, the best choice",
    0.08: "separated only after a long way",
}


def _takes(study: Study) -> dict[str, SceneRuns]:
    """By row label; the default method last."""
    close = ViewRequest(_TIMES, trail=3.0, affinity=True)
    configs = {f"σ = {s:g}": thesis(s) for s in SWITCHES} | {DEFAULT: study.options.default}
    return {
        label: study.simulated(_SCENE, config, period=_PERIOD, close=close)
        for label, config in configs.items()
    }


def draw_scenes(study: Study) -> Drawn:
    """Figure 4.1: a row per σ, three moments and the affinities at t = 5; the default method below."""
    takes, spec = _takes(study), spec_of(_SCENE)
    figure = panels.new_figure(11.5, 2.75 * len(takes))
    axes = figure.subplots(len(takes), len(_TIMES) + 1)
    for row, (label, take) in zip(axes, takes.items(), strict=True):
        first = take.seeds[0]
        styles = Styles(first)
        for panel, view in zip(row, first.views, strict=False):
            panels.scene_panel(panel, view, styles, spec, study.options.seeds[0])
        image = panels.affinity_panel(row[-1], first.views[1], first.names)
        panels.row_title(row[0], label)
    panels.affinity_bar(figure, image, list(axes[:, -1]))
    panels.object_legend(figure, takes[DEFAULT].seeds[0].names)
    return Drawn(figure, _perfect_rows(takes), _parameters(study))


def draw_nmi(study: Study) -> Drawn:
    """Figure 4.2: NMI over time for every σ and the default method."""
    takes = _takes(study)
    figure = panels.new_figure(9.5, 5.0)
    axes = figure.subplots()
    panels.switch_curves(axes, takes, DEFAULT)
    panels.nmi_axes(axes, duration=10, legend="center right")
    axes.set_title(panels.spread_note(study.options.seeds), fontsize=10)
    return Drawn(figure, _mean_rows(takes), _parameters(study), takes, summary(takes))


def _perfect_rows(takes: dict[str, SceneRuns]) -> list[Row]:
    rows = [
        Row(f"σ = {s:g}: NMI is 1 from", _SAID[s], format_times(perfect_from(takes[f"σ = {s:g}"])), "")
        for s in SWITCHES
    ]
    return [*rows, Row("NMI is 1 from", "-", "", format_times(perfect_from(takes[DEFAULT])))]


def _mean_rows(takes: dict[str, SceneRuns]) -> list[Row]:
    means = {label: spread(take.mean_nmi()) for label, take in takes.items()}
    rows = [
        Row(f"{label}: mean NMI", _SAID[s], means[label], "")
        for label, s in zip(means, SWITCHES, strict=False)
    ]
    return [*rows, Row("mean NMI", "-", "", means[DEFAULT])]


def _parameters(study: Study) -> dict[str, str]:
    made_with = parameters(_SCENE, thesis(0.02), study, _PERIOD)
    return made_with | {"thesis method": f"σ = {', '.join(f'{s:g}' for s in SWITCHES)}, equal weights"}
