"""Figures 3.3 to 3.6: affinities of trajectories, and the number of clusters by BIC and the eigengap."""

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion.thesis.alternatives import (
    COVARIANCES,
    MAX_EIGENVALUES,
    Mixture,
    count_clusters,
    mixtures,
    spectrum,
)

from ..offline import thesis
from ..tables import spread
from . import panels
from .runs import SceneRuns, ViewRequest
from .study import Drawn, Row, Simulated, Study, alone, count, count_at, parameters, row_of

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
    for letter, claim in printed.items():
        between = partial(_between, first="B", other=letter)
        rows.append(row_of(f"affinity of B to {letter} at t = {last:g} s", claim, takes, between))
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


_BIC_TIMES = (1.0, 3.0)
_GAP_TIMES = (1.0, 2.0, 3.0, 4.0, 7.0)
_STYLES = {
    "full": {"label": "full", "color": "#0072b2", "hatch": ""},
    "diag": {"label": "diagonal", "color": "#e69f00", "hatch": "//"},
    "spherical": {"label": "spherical", "color": "#009e73", "hatch": ".."},
}


def draw_bic(study: Study) -> Drawn:
    """Figure 3.4: BIC by components and kind of covariance, at t = 1 and t = 3."""
    takes = study.simulated(STARTS)
    divisive, default = takes.values()
    figure = panels.new_figure(8, 6.6)
    title = "Gaussian mixtures on the affinities of the thesis method"
    figure.suptitle(title, fontsize=11, fontweight="bold")
    rows = []
    for axes, t in zip(figure.subplots(2, 1, sharex=True), _BIC_TIMES, strict=True):
        fits = []
        for seed in range(1 if study.options.quick else len(divisive.seeds)):
            study.note(f"Gaussian mixtures at t = {t:g} s, seed {study.options.seeds[seed]}")
            fits.append(list(mixtures(_affinity(divisive, t, seed))))
        _bars(axes, t, fits[0])
        best = count([min(fit, key=lambda m: m.bic).components for fit in fits])
        counts = f"BIC {best}; divisive k-means {count_at(divisive, t)}"
        expected = f"expected {_expected(t)}; BIC suggests more"
        rows.append(Row(f"clusters at t = {t:g} s", expected, counts, count_at(default, t)))
    axes.set_xlabel("number of components")
    made_with = parameters(STARTS, study)
    return Drawn(figure, rows, made_with | {"variance floor": "1e-3"})


def draw_eigenvalues(study: Study) -> Drawn:
    """Figure 3.5: the first ten eigenvalues of L above and of L_norm below."""
    takes = study.simulated(STARTS)
    divisive, default = takes.values()
    figure = panels.new_figure(9, 5.6)
    figure.suptitle("graph Laplacian of the thesis method's affinities", fontsize=11, fontweight="bold")
    grid = figure.subplots(2, len(_GAP_TIMES), sharex=True)
    rows = []
    for (above, below), t in zip(grid.T, _GAP_TIMES, strict=True):
        plain = count(_eigen_panel(above, divisive, t, normalized=False))
        normalized = count(_eigen_panel(below, divisive, t, normalized=True))
        above.set_title(f"t = {t:g} s", fontsize=10)
        below.set_xlabel("index", fontsize=9)
        counts = f"L {plain}; L_norm {normalized}; divisive k-means {count_at(divisive, t)}"
        rows.append(Row(f"clusters at t = {t:g} s", f"expected {_expected(t)}", counts, count_at(default, t)))
    for row, name in zip(grid, ("L", "L$_{norm}$"), strict=True):
        row[0].set_ylabel(f"eigenvalue of {name}", fontsize=10)
    return Drawn(figure, rows, parameters(STARTS, study))


def _expected(t: float) -> int:
    return EXPECTED[START_TIMES.index(t)]


def _affinity(take: SceneRuns, t: float, seed: int) -> NDArray[np.float64]:
    """Of the view of a seed nearest to a time."""
    view = min(take.seeds[seed].views, key=lambda view: abs(view.t - t))
    return view.affinity.astype(np.float64)


def _bars(axes: Any, t: float, mixtures: list[Mixture]) -> None:
    """Bars of one seed, a star over the smallest."""

    def place(mixture: Mixture) -> float:
        return mixture.components + 0.27 * (COVARIANCES.index(mixture.covariance) - 1)

    best = min(mixtures, key=lambda mixture: mixture.bic)
    # Full covariances grow without bound; what decides is at the bottom.
    low, top = best.bic / 1e3, -1.2 * best.bic / 1e3
    for kind in COVARIANCES:
        fits = [m for m in mixtures if m.covariance == kind]
        heights = [min(m.bic / 1e3, top) for m in fits]
        axes.bar([place(m) for m in fits], heights, 0.25, edgecolor="white", linewidth=0.4, **_STYLES[kind])
    axes.set_ylim(1.35 * low, 1.45 * top)
    for mixture in mixtures:
        if mixture.bic / 1e3 > top:
            axes.text(place(mixture), top, f"{mixture.bic / 1e3:.0f}", fontsize=7, ha="center", va="bottom")
    axes.plot(place(best), 1.16 * low, "*", color="black", markersize=11)
    expected = _expected(t)
    axes.axvline(expected, color="0.3", linestyle=":", linewidth=1.5, zorder=0, label=f"expected: {expected}")
    axes.axhline(0, color="black", linewidth=0.6)
    axes.set_xticks(range(1, 11))
    axes.set_ylabel("BIC [10³]")
    axes.set_title(f"t = {t:g} s: minimum (★) at {best.components} components", fontsize=10)
    axes.legend(fontsize=8, ncols=4, loc="upper center")


def _eigen_panel(axes: Any, take: SceneRuns, t: float, *, normalized: bool) -> list[int]:
    """Eigenvalues of every seed; answers with the clusters that their gaps suggest."""
    affinities = (_affinity(take, t, seed) for seed in range(len(take.seeds)))
    spectra = [spectrum(affinity, normalized=normalized)[0] for affinity in affinities]
    values = np.array([eigenvalues[:MAX_EIGENVALUES] for eigenvalues in spectra])
    index = np.arange(1, MAX_EIGENVALUES + 1)
    axes.fill_between(index, values.min(axis=0), values.max(axis=0), color="#0072b2", alpha=0.2, linewidth=0)
    axes.plot(index, values.mean(axis=0), "o-", color="#0072b2", markersize=4, linewidth=1)
    expected = _expected(t)
    axes.axvline(expected + 0.5, color="0.3", linestyle=":", linewidth=1.5)
    axes.set_xticks([1, 4, 7, 10])
    axes.tick_params(labelsize=8)
    axes.grid(visible=True, alpha=0.3)
    return [count_clusters(value) for value in values]
