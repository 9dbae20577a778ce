"""Figures 3.3 and 3.6: affinities of trajectories."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .numbers import count_at, parameters, row_of
from .runs import SceneRuns, ViewRequest
from .study import DEFAULT, Drawn, Simulated, Study, alone

START_TIMES = (1.0, 2.0, 3.0, 4.0, 7.0, 9.0)
EXPECTED = (2, 3, 4, 5, 5, 5)
"""Clusters that the thesis expects at these times, one more per start (the last one is not in the thesis)."""
STARTS = Simulated("fig3_3", alone(thesis(0.01)), 0.2, ViewRequest(START_TIMES, trail=2.0, affinity=True))
"""The scene of figures 3.3 to 3.5."""
_TIMES = (1.0, 2.0, 3.0, 4.0)
_DIRECTION = Simulated("fig3_6", alone(thesis(0.01)), 0.2, ViewRequest(_TIMES, trail=4.0, affinity=True))


def draw_starts(study: Study) -> Drawn:
    """Figure 3.3: scenes in rows 1 and 3, their affinities in rows 2 and 4."""
    takes = study.simulated(STARTS)
    figure = panels.new_figure(13, 10.2)
    for part, take in panels.halves(figure, takes):
        axes = part.subplots(4, 3)
        panels.scene_panels(axes[[0, 2]].ravel(), take, STARTS.scene, study)
        _affinities(part, take, axes[[1, 3]].ravel())
    panels.object_legend(figure, takes[DEFAULT].seeds[0].names)
    rows = [
        row_of(f"hypotheses at t = {t:g} s", str(expected), takes, partial(count_at, t=t))
        for t, expected in zip(START_TIMES, EXPECTED, strict=True)
    ]
    rows.append(row_of("mean NMI", "-", takes, lambda take: spread(take.mean_nmi())))
    return Drawn(figure, rows, parameters(STARTS, study))


def draw_direction(study: Study) -> Drawn:
    """Figure 3.6: scenes in the upper row, affinities in the lower one."""
    takes = study.simulated(_DIRECTION)
    figure = panels.new_figure(13, 4.9)
    for part, take in panels.halves(figure, takes):
        axes = part.subplots(2, 4)
        panels.scene_panels(axes[0], take, _DIRECTION.scene, study)
        _affinities(part, take, axes[1])
        for upper in axes[0]:
            upper.set(xlim=(-0.05, 0.85), ylim=(0.05, 0.85))
    panels.object_legend(figure, takes[DEFAULT].seeds[0].names)
    printed = {"Y": "small", "G": "particularly high", "R": "-", "P": "-"}
    last = _TIMES[-1]
    rows = []
    for letter, said in printed.items():
        between = partial(_between, first="B", other=letter)
        rows.append(row_of(f"affinity of B to {letter} at t = {last:g} s", said, takes, between))
    rows.append(row_of("hypotheses at the end", "2", takes, partial(count_at, t=last)))
    return Drawn(figure, rows, parameters(_DIRECTION, study))


def _affinities(part: Any, take: SceneRuns, row: Sequence[Any]) -> None:
    """Draw the affinities of the views of the first seed, one in each of the axes, and their scale."""
    first = take.seeds[0]
    for axes, view in zip(row, first.views, strict=True):
        image = panels.affinity_panel(axes, view, first.names)
    panels.affinity_bar(part, image, list(row))


def _between(take: SceneRuns, first: str, other: str) -> str:
    """Mean affinity of the features of two objects in the last view, over seeds."""
    values = []
    for seed in take.seeds:
        view, numbers = seed.views[-1], {name: number for number, name in seed.names.items()}
        rows = view.affinity_objects == numbers[first]
        columns = view.affinity_objects == numbers[other]
        values.append(view.affinity[np.ix_(rows, columns)].mean())
    return f"{np.mean(values):.3f}"
