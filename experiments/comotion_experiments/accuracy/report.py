"""The accuracy report as Markdown and as a picture."""

from pathlib import Path
from typing import Any

import numpy as np

from ..plot import new_figure
from ..tables import Table, filled, mean, spread
from .experiment import DEFAULT, ROBUST_SCENES, THESIS, Results

# Scenes in which the truth separates bodies that have not moved yet, so no method can.
_UNKNOWABLE = ("fig4_3", "fig3_3", "3d_late", "3d_static")
_GROUPS = {
    "thesis scenes": "thesis_scenes",
    "3-D set": "space",
    "two sources": "two_sources",
    "recordings": "recordings",
}
"""Groups of cases, and where each stands in the page."""


def markdown(results: Results, picture: str) -> str:
    """Format the report; `picture` is the path of the reliability diagram."""
    parts: dict[str, str | Table] = {"seeds": ", ".join(map(str, results.seeds)), "picture": picture}
    if "scores" in results.parts:
        parts |= {place: _table(results, group) for group, place in _GROUPS.items() if results.names(group)}
        rows = [
            (f"{confidence:.3f}", f"{right:.3f}", f"{count}") for confidence, right, count in bins(results)
        ]
        parts["reliability"] = Table(("confidence", "right", "assignments"), 0, [*rows])
    if "motion" in results.parts:
        medians = [(name, f"{value:.2f}") for name, value in results.motion.items()]
        parts["motion"] = Table(("error", "median"), rows=[*medians])
    parts |= _compared(results) | _robustness(results)
    return filled(Path(__file__).with_name("page.md"), parts)


def as_json(results: Results) -> Any:
    """Values for JSON: mean NMI of each case by method and seed, and the other parts that were run."""
    scores: dict[str, dict[str, list[float]]] = {}
    for row in results.rows:
        scores.setdefault(row["case"], {}).setdefault(row["method"], []).append(row["nmi"])
    return {
        "seeds": results.seeds,
        "nmi": scores,
        "comparator": results.compared,
        "motion": results.motion or None,
        "parameters": results.variations,
    }


def _table(results: Results, group: str) -> Table:
    table = Table(["", "default", "t ≥ 1 s", "switches", "thesis", "switches"])
    names = results.names(group)
    for name in names:
        ours = (spread(results.of(name, DEFAULT, figure)) for figure in ("nmi", "late"))
        switches = (f"{np.mean(results.of(name, method, 'switches')):.2f}" for method in (DEFAULT, THESIS))
        table.add(name, *ours, next(switches), spread(results.of(name, THESIS, "nmi")), next(switches))
    if group == "recordings":
        ours, theirs = (np.mean([results.of(n, m, "nmi") for n in names]) for m in (DEFAULT, THESIS))
        table.add("**mean**", f"**{ours:.3f}**", "", "", f"{theirs:.3f}", "")
    return table


def _compared(results: Results) -> dict[str, str | Table]:
    """The comparator, mean over the cases of a group, beside both methods at the same times."""
    if not results.compared:
        return {}
    groups = {case.name: case.group for case in results.cases}
    rows = {}
    for name, compared in results.compared.items():
        ours = [results.of(name, method, "whole") for method in (DEFAULT, THESIS)]
        rows[name] = [float(np.mean(cell)) for cell in (*ours, *compared.values())]
    table = Table(("", "default", "thesis", *next(iter(results.compared.values()))))
    for group in dict.fromkeys(groups[name] for name in rows):
        some = [row for name, row in rows.items() if groups[name] == group]
        table.add(f"{group} ({len(some)})", *(f"{score:.3f}" for score in np.mean(some, 0)))
    table.add("**mean**", *(f"{score:.3f}" for score in np.mean(list(rows.values()), 0)))
    better = ", ".join(
        f"{name} ({max(row[2:]):.3f} against {row[0]:.3f})"
        for name, row in rows.items()
        if max(row[2:]) > row[0]
    )
    return {"compared": table, "better": better or "nowhere"}


def bins(results: Results) -> list[tuple[float, float, int]]:
    """Mean confidence, share of right assignments and count of each bin that is not empty.

    Of all simulated assignments with known truth.
    """
    names = [name for group in list(_GROUPS)[:2] for name in results.names(group) if name not in _UNKNOWABLE]
    sums = sum((bins for name in names for bins in results.of(name, DEFAULT, "bins")), np.zeros((1, 3)))
    return [(sure / n, right / n, int(n)) for sure, right, n in sums.tolist() if n]


def _robustness(results: Results) -> dict[str, str | Table]:
    """Parameters halved and doubled; and cross-validation: each setting is chosen on the other recordings."""
    if not results.variations:
        return {}
    base, *scaled = results.variations
    table = Table(("parameter", "halved", "doubled"))
    for halved, doubled in zip(scaled[::2], scaled[1::2], strict=True):
        table.add(halved["parameter"], *(f"{mean(v['scores'].values()):.3f}" for v in (halved, doubled)))
    as_it_is, names, left_out = mean(base["scores"].values()), results.names("recordings"), ""
    if len(names) > 1:
        scores = np.array([[v["scores"][name] for name in names] for v in results.variations])
        chosen = [int(np.delete(scores, k, axis=1).mean(axis=1).argmax()) for k in range(len(names))]
        there = scores[chosen, np.arange(len(names))].mean()
        left_out = _LEFT_OUT.format(there=there, as_it_is=scores[0].mean())
    scenes = ", ".join(ROBUST_SCENES)
    texts = {"robust_scenes": scenes, "as_it_is": f"{as_it_is:.3f}", "left_out": left_out}
    return {**texts, "robustness": table}


_LEFT_OUT = """Where the setting of this table with the best mean on all other recordings is chosen for each
recording, it scores {there:.3f} there on average, as it is {as_it_is:.3f}."""


def save_reliability(path: Path, results: Results) -> None:
    """Draw the reliability diagram."""
    shares = np.array(bins(results))
    figure = new_figure(5, 4.5)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="#999999", linewidth=1)
    axes.plot(shares[:, 0], shares[:, 1], marker="o", color="#0072b2")
    for x, y, n in shares:
        axes.annotate(f"{int(n)}", (x, y), textcoords="offset points", xytext=(5, -10), fontsize=7)
    axes.set(xlabel="confidence", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02))
    figure.savefig(path)
