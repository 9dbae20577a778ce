"""Figure 4.3: weights by velocity, when an object starts to move after 10 s at rest."""

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .figure import Drawn, Row
from .numbers import DEFAULT, parameters, perfect_from, summary
from .runs import SceneRuns
from .study import Study

_SCENE, _PERIOD, _START, _END = "fig4_3", 1 / 15, 10.0, 12.67
_SWITCH = 0.01
_CONFIGS = {
    "equal weights": thesis(_SWITCH),
    "v = 0.001": thesis(_SWITCH, 0.001),
    "v = 0.1": thesis(_SWITCH, 0.1),
}


def draw_weights(study: Study) -> Drawn:
    """Figure 4.3: NMI over time for equal weights, a tiny v and a good one; the start enlarged."""
    takes = {name: study.simulated(_SCENE, config, period=_PERIOD) for name, config in _CONFIGS.items()}
    takes[DEFAULT] = study.simulated(_SCENE, study.options.default, period=_PERIOD)
    figure = panels.new_figure(12, 4.6)
    whole, close = figure.subplots(1, 2, width_ratios=[3, 2])
    for k, (label, take) in enumerate(takes.items()):
        if label == DEFAULT:
            style = {"colour": panels.DEFAULT_COLOUR, "width": 2.6, "order": 5}
        else:
            # The first two coincide: the dashes of the second let the first one through.
            hue = ("#e69f00", "#0072b2", "#d55e00")[k]
            style = {"colour": hue, "dashes": ("-", (0, (4, 3)), "-")[k], "order": 2 + k}
        for axes in (whole, close):
            panels.curve(axes, take, label, **style)  # type: ignore[arg-type]
    panels.nmi_axes(whole, duration=_END, legend="upper left")
    panels.nmi_axes(close, duration=_END)
    close.set_xlim(_START - 0.1, _START + 1.3)
    close.set_title("the start of the motion", fontsize=10)
    whole.set_title(panels.spread_note(study.options.seeds), fontsize=10)
    for axes in (whole, close):
        axes.axvline(_START, color="0.5", linewidth=1, linestyle=":")
    made_with = parameters(_SCENE, _CONFIGS["equal weights"], study, _PERIOD)
    made_with["thesis method"] = f"σ = {_SWITCH:g}; equal weights, v = 0.001, v = 0.1"
    made_with.pop("drawn")
    return Drawn(figure, _rows(takes), made_with, takes, summary(takes))


def _rows(takes: dict[str, SceneRuns]) -> list[Row]:
    said = {
        "equal weights": "the baseline",
        "v = 0.001": "not very different from equal weights",
        "v = 0.1": "sooner, although the effect is quite small",
    }
    default = takes[DEFAULT]
    what = "NMI is 1, after the start"
    rows = [Row(f"{name}: {what}", text, _late(takes[name]), "") for name, text in said.items()]
    rows.append(Row(what, "-", "", _late(default)))
    at_rest = (take.nmi[:, take.t < _START].max() for take in (takes["equal weights"], default))
    resting = (f"{value:.3f}" for value in at_rest)
    return [*rows, Row("largest NMI before the start", "nothing has moved", *resting)]


def _late(take: SceneRuns) -> str:
    return f"{spread(np.asarray(perfect_from(take)) - _START, 2)} s"
