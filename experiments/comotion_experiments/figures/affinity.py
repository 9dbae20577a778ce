"""Figures 3.3 and 3.6: affinities of trajectories."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .colouring import Styles
from .figure import Drawn, Row
from .numbers import count, parameters
from .runs import SceneRuns, ViewRequest
from .study import Study, describe, spec_of

STARTS = "fig3_3"
START_TIMES = (1.0, 2.0, 3.0, 4.0, 7.0, 9.0)
EXPECTED = (2, 3, 4, 5, 5, 5)
"""Clusters that the thesis expects at these times, one more per start (the last one is not in the thesis)."""
STARTS_CONFIG = thesis(0.01)
_DIRECTION = "fig3_6"
_DIRECTION_TIMES = (1.0, 2.0, 3.0, 4.0)
_DIRECTION_CONFIG = thesis(0.01)
_PERIOD = 0.2


def starts(study: Study) -> tuple[SceneRuns, SceneRuns]:
    """The scene of figures 3.3 to 3.5 with the thesis method and with the default one."""
    close = ViewRequest(START_TIMES, trail=2.0, affinity=True)
    return study.both(STARTS, STARTS_CONFIG, period=_PERIOD, close=close)


def draw_starts(study: Study) -> Drawn:
    """Figure 3.3: scenes in rows 1 and 3, their affinities in rows 2 and 4."""
    takes = starts(study)
    figure = panels.new_figure(13, 10.2)
    for part, take in zip(panels.halves(figure, *_titles(STARTS_CONFIG)), takes, strict=True):
        axes = part.subplots(4, 3)
        _scenes_over_affinities(part, take, STARTS, axes[[0, 2]].ravel(), axes[[1, 3]].ravel(), study)
    panels.object_legend(figure, takes[0].seeds[0].names)
    rows = [
        Row(f"hypotheses at t = {t:g} s", str(expected), *(_count_at(take, t) for take in takes))
        for t, expected in zip(START_TIMES, EXPECTED, strict=True)
    ]
    rows.append(Row("mean NMI", "-", *(spread(take.mean_nmi()) for take in takes)))
    return Drawn(figure, rows, parameters(STARTS, STARTS_CONFIG, study, _PERIOD))


def draw_direction(study: Study) -> Drawn:
    """Figure 3.6: scenes in the upper row, affinities in the lower one."""
    close = ViewRequest(_DIRECTION_TIMES, trail=4.0, affinity=True)
    takes = study.both(_DIRECTION, _DIRECTION_CONFIG, period=_PERIOD, close=close)
    figure = panels.new_figure(13, 4.9)
    for part, take in zip(panels.halves(figure, *_titles(_DIRECTION_CONFIG)), takes, strict=True):
        axes = part.subplots(2, 4)
        _scenes_over_affinities(part, take, _DIRECTION, axes[0], axes[1], study)
        for upper in axes[0]:
            upper.set_xlim(-0.05, 0.85)
            upper.set_ylim(0.05, 0.85)
    panels.object_legend(figure, takes[0].seeds[0].names)
    printed = {"Y": "small", "G": "particularly high", "R": "-", "P": "-"}
    rows = [
        Row(
            f"affinity of B to {letter} at t = {_DIRECTION_TIMES[-1]:g} s",
            said,
            *(f"{_between(take, 'B', letter):.3f}" for take in takes),
        )
        for letter, said in printed.items()
    ]
    rows.append(Row("hypotheses at the end", "2", *(_count_at(t, _DIRECTION_TIMES[-1]) for t in takes)))
    return Drawn(figure, rows, parameters(_DIRECTION, _DIRECTION_CONFIG, study, _PERIOD))


def _titles(config: Any) -> tuple[str, str]:
    return describe(config), "default method"


def _scenes_over_affinities(
    part: Any, take: SceneRuns, scene: str, above: Sequence[Any], below: Sequence[Any], study: Study
) -> None:
    first, spec = take.seeds[0], spec_of(scene)
    styles = Styles(first)
    for view, upper, lower in zip(first.views, above, below, strict=True):
        panels.scene_panel(upper, view, styles, spec, study.options.seeds[0])
        image = panels.affinity_panel(lower, view, first.names)
    panels.affinity_bar(part, image, list(below))


def _between(take: SceneRuns, first: str, other: str) -> float:
    """Mean affinity of the features of two objects in the last view, over seeds."""
    values = []
    for seed in take.seeds:
        view, numbers = seed.views[-1], {name: number for number, name in seed.names.items()}
        rows = view.affinity_objects == numbers[first]
        columns = view.affinity_objects == numbers[other]
        values.append(view.affinity[np.ix_(rows, columns)].mean())
    return float(np.mean(values))


def _count_at(take: SceneRuns, t: float) -> str:
    return count(take.hypotheses[:, np.abs(take.t - t).argmin()])
