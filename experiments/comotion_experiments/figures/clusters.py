"""Figures 3.4 and 3.5: finding the number of clusters by BIC, and by the eigengap."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion.thesis.alternatives import (
    COVARIANCES,
    MOST_EIGENVALUES,
    Mixture,
    count_clusters,
    mixtures,
    spectrum,
)

from . import panels
from .affinity import EXPECTED, START_TIMES, STARTS, STARTS_CONFIG, starts
from .figure import Drawn, Row
from .numbers import DEFAULT, count, parameters, view_at
from .runs import SceneRuns
from .study import Study

BIC_TIMES = (1.0, 3.0)
GAP_TIMES = (1.0, 2.0, 3.0, 4.0, 7.0)
_NAMES = {"full": "full", "diag": "diagonal", "spherical": "spherical"}
_COLOURS = {"full": "#0072b2", "diag": "#e69f00", "spherical": "#009e73"}
_HATCHES = {"full": "", "diag": "//", "spherical": ".."}
Counts = dict[str, NDArray[np.float64]]


def draw_bic(study: Study) -> Drawn:
    """Figure 3.4: BIC by components and kind of covariance, at t = 1 and t = 3."""
    takes = starts(study)
    fitted = range(1 if study.options.quick else len(takes[0].seeds))
    fits = {t: [_fits(study, takes[0], t, seed) for seed in fitted] for t in BIC_TIMES}
    figure = panels.new_figure(12.5, 6.6)
    left, right = figure.subfigures(1, 2, width_ratios=[3, 2])
    left.suptitle("Gaussian mixtures on the affinities of the thesis method", fontsize=11, fontweight="bold")
    for axes, t in zip(left.subplots(2, 1, sharex=True), BIC_TIMES, strict=True):
        _bars(axes, t, fits[t][0])
    axes.set_xlabel("number of components")
    best = {
        t: np.array([min(mixtures, key=lambda m: m.bic).components for mixtures in fits[t]])
        for t in BIC_TIMES
    }
    counts = _counts(takes, START_TIMES)
    bic = np.full((len(takes[0].seeds), len(START_TIMES)), np.nan)
    for t in BIC_TIMES:
        bic[: len(best[t]), START_TIMES.index(t)] = best[t]
    _count_panel(right, {"minimal BIC": bic, **counts}, study)
    rows = [
        Row(
            f"clusters at t = {t:g} s",
            f"expected {EXPECTED[START_TIMES.index(t)]}; BIC suggests more",
            f"BIC {count(best[t])}; divisive k-means {count(counts['divisive k-means'][:, k])}",
            count(counts[DEFAULT][:, k]),
        )
        for t in BIC_TIMES
        for k in [START_TIMES.index(t)]
    ]
    return Drawn(figure, rows, parameters(STARTS, STARTS_CONFIG, study, 0.2) | {"variance floor": "1e-3"})


def draw_eigenvalues(study: Study) -> Drawn:
    """Figure 3.5: the first ten eigenvalues of L above and of L_norm below."""
    takes = starts(study)
    figure = panels.new_figure(13.5, 5.6)
    left, right = figure.subfigures(1, 2, width_ratios=[3.6, 2])
    left.suptitle("graph Laplacian of the thesis method's affinities", fontsize=11, fontweight="bold")
    grid = left.subplots(2, len(GAP_TIMES), sharex=True)
    gaps: Counts = {}
    for row, normalized, name in zip(grid, (False, True), ("L", "L$_{norm}$"), strict=True):
        label = f"eigengap of {name}"
        gaps[label] = np.full((len(takes[0].seeds), len(START_TIMES)), np.nan)
        for axes, t in zip(row, GAP_TIMES, strict=True):
            gaps[label][:, START_TIMES.index(t)] = _eigen_panel(axes, takes[0], t, normalized=normalized)
        row[0].set_ylabel(f"eigenvalue of {name}", fontsize=10)
    for axes, t in zip(grid[0], GAP_TIMES, strict=True):
        axes.set_title(f"t = {t:g} s", fontsize=10)
    for axes in grid[1]:
        axes.set_xlabel("index", fontsize=9)
    counts = {**gaps, **_counts(takes, START_TIMES)}
    _count_panel(right, counts, study)
    return Drawn(figure, _gap_rows(counts), parameters(STARTS, STARTS_CONFIG, study, 0.2))


def _gap_rows(counts: Counts) -> list[Row]:
    rows = []
    for t in GAP_TIMES:
        k = START_TIMES.index(t)
        plain, normalized, divisive, default = (count(values[:, k]) for values in counts.values())
        said = f"L {plain}; L_norm {normalized}; divisive k-means {divisive}"
        rows.append(Row(f"clusters at t = {t:g} s", f"expected {EXPECTED[k]}", said, default))
    return rows


def _fits(study: Study, take: SceneRuns, t: float, seed: int) -> list[Mixture]:
    study.note(f"Gaussian mixtures at t = {t:g} s, seed {study.options.seeds[seed]}")
    return list(mixtures(_affinity(take, t, seed)))


def _affinity(take: SceneRuns, t: float, seed: int) -> NDArray[np.float64]:
    return view_at(take, t, seed).affinity.astype(np.float64)


def _bars(axes: Any, t: float, mixtures: list[Mixture]) -> None:
    """Bars of one seed, a star over the smallest."""
    best = min(mixtures, key=lambda mixture: mixture.bic)
    for offset, kind in enumerate(COVARIANCES):
        some = [m for m in mixtures if m.covariance == kind]
        places = [m.components + 0.27 * (offset - 1) for m in some]
        axes.bar(
            places,
            [min(m.bic, -1.2 * best.bic) / 1e3 for m in some],
            width=0.25,
            color=_COLOURS[kind],
            hatch=_HATCHES[kind],
            edgecolor="white",
            linewidth=0.4,
            label=_NAMES[kind],
        )
    # Full covariances grow without bound; what decides is at the bottom.
    low = best.bic / 1e3
    top = -1.2 * low
    axes.set_ylim(1.35 * low, 1.45 * top)
    for mixture in mixtures:
        if mixture.bic / 1e3 > top:
            place = mixture.components + 0.27 * (COVARIANCES.index(mixture.covariance) - 1)
            axes.text(place, top, f"{mixture.bic / 1e3:.0f}", fontsize=7, ha="center", va="bottom")
    star = best.components + 0.27 * (COVARIANCES.index(best.covariance) - 1)
    axes.plot(star, 1.16 * low, "*", color="black", markersize=11)
    expected = EXPECTED[START_TIMES.index(t)]
    axes.axvline(expected, color="0.3", linestyle=":", linewidth=1.5, zorder=0, label=f"expected: {expected}")
    axes.axhline(0, color="black", linewidth=0.6)
    axes.set_xticks(range(1, 11))
    axes.set_ylabel("BIC [10³]")
    axes.set_title(f"t = {t:g} s: minimum (★) at {best.components} components", fontsize=10)
    axes.legend(fontsize=8, ncols=4, loc="upper center")


def _eigen_panel(axes: Any, take: SceneRuns, t: float, *, normalized: bool) -> list[int]:
    """Eigenvalues of every seed; answers with the clusters that their gaps suggest."""
    values = np.array(
        [
            spectrum(_affinity(take, t, seed), normalized=normalized)[0][:MOST_EIGENVALUES]
            for seed in range(len(take.seeds))
        ]
    )
    index = np.arange(1, MOST_EIGENVALUES + 1)
    axes.fill_between(index, values.min(axis=0), values.max(axis=0), color="#0072b2", alpha=0.2, linewidth=0)
    axes.plot(index, values.mean(axis=0), "o-", color="#0072b2", markersize=4, linewidth=1)
    expected = EXPECTED[START_TIMES.index(t)]
    axes.axvline(expected + 0.5, color="0.3", linestyle=":", linewidth=1.5)
    axes.set_xticks([1, 4, 7, 10])
    axes.tick_params(labelsize=8)
    axes.grid(visible=True, alpha=0.3)
    return [count_clusters(value) for value in values]


def _counts(takes: tuple[SceneRuns, SceneRuns], times: tuple[float, ...]) -> Counts:
    """Hypotheses at times [seeds, times], by method."""
    pick: Callable[[SceneRuns], NDArray[np.float64]] = lambda take: np.stack(  # noqa: E731
        [take.hypotheses[:, np.abs(take.t - t).argmin()] for t in times], axis=1
    ).astype(np.float64)
    return {"divisive k-means": pick(takes[0]), DEFAULT: pick(takes[1])}


def _count_panel(part: Any, counts: Counts, study: Study) -> None:
    part.suptitle("clusters found", fontsize=11, fontweight="bold")
    axes = part.subplots()
    styles = iter(zip(("v", "s", "D", "P"), ("#cc79a7", "#56b4e9", "#d55e00", "#009e73"), strict=True))
    shift = np.linspace(-0.18, 0.18, len(counts))
    for offset, (label, values) in zip(shift, counts.items(), strict=True):
        shape, hue = ("o", panels.DEFAULT_COLOUR) if label == DEFAULT else next(styles)
        known = np.isfinite(values).any(axis=0)
        mean, deviation = np.nanmean(values[:, known], axis=0), np.nanstd(values[:, known], axis=0)
        axes.errorbar(
            np.array(START_TIMES)[known] + offset,
            mean,
            deviation,
            marker=shape,
            linestyle="",
            color=hue,
            capsize=2,
            markersize=6,
            label=label,
        )
    axes.step([0, 1, 2, 3, 9.3], [2, 2, 3, 4, 5], where="pre", color="0.3", linestyle=":", label="expected")
    axes.set_xlabel("t [s]")
    axes.set_ylabel("number of clusters")
    axes.set_ylim(0, 11.5)
    axes.set_yticks(range(12))
    axes.set_xticks(START_TIMES)
    axes.grid(visible=True, alpha=0.3)
    title = panels.spread_note(study.options.seeds, "bars")
    axes.legend(fontsize=8.5, loc="upper right", title=title, title_fontsize=8)
