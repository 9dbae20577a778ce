"""Figures 3.3 and 3.6: affinities of trajectories."""

from functools import partial

import numpy as np

from ..offline import thesis
from ..tables import spread
from . import panels
from .numbers import count_at, parameters, row_of
from .runs import SceneRuns, ViewRequest
from .study import Drawn, Simulated, Study, alone

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
    figure = panels.scene_figure(study, STARTS, takes, (13, 10.2), (4, 3))
    rows = [
        row_of(f"hypotheses at t = {t:g} s", str(expected), takes, partial(count_at, t=t))
        for t, expected in zip(START_TIMES, EXPECTED, strict=True)
    ]
    rows.append(row_of("mean NMI", "-", takes, lambda take: spread(take.mean_nmi())))
    return Drawn(figure, rows, parameters(STARTS, study))


def draw_direction(study: Study) -> Drawn:
    """Figure 3.6: scenes in the upper row, affinities in the lower one."""
    takes = study.simulated(_DIRECTION)
    figure = panels.scene_figure(study, _DIRECTION, takes, (13, 4.9), (2, 4))
    for upper in (axes for part in figure.subfigs for axes in part.axes[:4]):
        upper.set(xlim=(-0.05, 0.85), ylim=(0.05, 0.85))
    printed = {"Y": "small", "G": "particularly high", "R": "-", "P": "-"}
    last = _TIMES[-1]
    rows = []
    for letter, said in printed.items():
        between = partial(_between, first="B", other=letter)
        rows.append(row_of(f"affinity of B to {letter} at t = {last:g} s", said, takes, between))
    rows.append(row_of("hypotheses at the end", "2", takes, partial(count_at, t=last)))
    return Drawn(figure, rows, parameters(_DIRECTION, study))


def _between(take: SceneRuns, first: str, other: str) -> str:
    """Mean affinity of the features of two objects in the last view, over seeds."""
    values = []
    for seed in take.seeds:
        view, numbers = seed.views[-1], {name: number for number, name in seed.names.items()}
        rows = view.affinity_objects == numbers[first]
        columns = view.affinity_objects == numbers[other]
        values.append(view.affinity[np.ix_(rows, columns)].mean())
    return f"{np.mean(values):.3f}"
