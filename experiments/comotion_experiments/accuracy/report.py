"""Runs the cases of the accuracy report, and writes it as Markdown."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from comotion import FusionConfig

from ..offline import thesis
from ..study import Progress, Row, quiet, run_study, values
from ..tables import Table, filled, mean, number, spread
from .cases import DISPLACED, RECORDINGS, SPATIAL, THESIS_SCENES, Case, motion_errors, run_case

METHODS = DEFAULT, THESIS = "comotion", "thesis"
PARTS = ("scores", "motion")
"""Parts of the report: both methods on every case, and poses."""
# Scenes in which the truth separates bodies that have not moved yet, so no method can.
_UNKNOWABLE = ("fig4_3", "fig3_3", "3d_late", "3d_static")
_PLACES = {
    THESIS_SCENES: "thesis_scenes",
    SPATIAL: "space",
    DISPLACED: "two_sources",
    RECORDINGS: "recordings",
}
"""Where each group of cases stands in the page."""


def run_experiment(
    cases: Sequence[Case],
    seeds: Sequence[int],
    parts: Sequence[str],
    *,
    jobs: int = 1,
    progress: Progress = quiet,
) -> dict[str, Any]:
    """Run parts of the report; `rows` of all cases and `motion`, as far as they are parts."""
    results: dict[str, Any] = {"seeds": seeds}
    if "scores" in parts:
        results["rows"] = run_study(_scored, cases, METHODS, seeds, jobs=jobs, progress=progress)
    if "motion" in parts:
        progress("pose and twist")
        results["motion"] = motion_errors(seeds)
    return results


def _scored(case: Case, method: str, seed: int) -> Row:
    return run_case(case, FusionConfig() if method == DEFAULT else thesis(case.sigma_switch), seed)


def markdown(results: dict[str, Any]) -> str:
    """Format the report."""
    page: dict[str, str | Table] = {"seeds": ", ".join(map(str, results["seeds"]))}
    if "rows" in results:
        rows = results["rows"]
        page |= {_PLACES[group]: _table(rows, group) for group in dict.fromkeys(row["group"] for row in rows)}
        page["reliability"] = _reliability(rows)
    if "motion" in results:
        medians = [(name, f"{value:.2f}") for name, value in results["motion"].items()]
        page["motion"] = Table(("error", "median"), rows=[*medians])
    return filled(Path(__file__).with_name("page.md"), page)


def _table(rows: Sequence[Row], group: str) -> Table:
    table = Table(["", "default", "t ≥ 1 s", "switches", "thesis", "switches"])
    for name in dict.fromkeys(row["case"] for row in rows if row["group"] == group):
        ours, theirs = ({"case": name, "setting": method} for method in METHODS)
        table.add(
            name,
            spread(values(rows, "nmi", **ours)),
            spread(values(rows, "late", **ours)),
            number(mean(values(rows, "switches", **ours)), 2),
            spread(values(rows, "nmi", **theirs)),
            number(mean(values(rows, "switches", **theirs)), 2),
        )
    if group == RECORDINGS:
        nmi = (values(rows, "nmi", group=group, setting=method) for method in METHODS)
        table.add("**mean**", f"**{mean(next(nmi)):.3f}**", "", "", f"{mean(next(nmi)):.3f}", "")
    return table


def _reliability(rows: Sequence[Row]) -> Table:
    """Mean confidence, share of right assignments and count of each bin that is not empty, of scenes."""
    table = Table(("confidence", "right", "assignments"), 0)
    scenes = [row for row in rows if row["group"] in (THESIS_SCENES, SPATIAL)]
    known = [row for row in scenes if row["case"] not in _UNKNOWABLE]
    for confidence, right, n in sum(values(known, "bins", setting=DEFAULT), np.zeros((1, 3))).tolist():
        if n:
            table.add(f"{confidence / n:.3f}", f"{right / n:.3f}", f"{n:.0f}")
    return table
