"""The link experiment as a table and as JSON."""

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from comotion_clients.scoring import finite_or_none

from .experiment import Case, Results

_READINGS = ("apart", "rest", "joined", "oracle")
HEADINGS = (
    "scene",
    "moving: P/R % (n)",
    "pure",
    "resting",
    "NMI apart",
    "rest",
    "joined",
    "oracle",
    "plain: apart",
    "joined",
    "error %: apart",
    "joined",
)


def table(results: Results) -> Table:
    """One row per scene: means and, after ±, the spread over seeds."""
    found = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for number, title in enumerate(HEADINGS):
        found.add_column(title, justify="right" if number else "left", no_wrap=True)
    for cells in rows(results):
        found.add_row(*cells)
    return found


def markdown(results: Results) -> str:
    """The same as a table for the documentation."""
    lines = [HEADINGS, ["---", *["---:"] * (len(HEADINGS) - 1)], *rows(results)]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def rows(results: Results) -> list[list[str]]:
    """Cells of the table; the last row is of all scenes."""
    return [_cells(case) for case in [*results.cases, results.all()]]


def _cells(case: Case) -> list[str]:
    return [
        case.scene,
        _links(case, "moving"),
        _links(case, "pure"),
        _links(case, "resting"),
        *(_spread(case.scores("nmi", reading)) for reading in _READINGS),
        *(_spread(case.scores("nmi_plain", reading)) for reading in ("apart", "joined")),
        *(_spread(100 * case.scores("error_plain", reading), 1) for reading in ("apart", "joined")),
    ]


def _links(case: Case, what: str) -> str:
    """Precision, recall and how many could be linked."""
    count = case.count(what)
    return f"{_percent(count.precision)}/{_percent(count.recall)} ({count.linkable})"


def _percent(share: float) -> str:
    return "-" if np.isnan(share) else f"{100 * share:.0f}"


def _spread(values: NDArray[np.float64], digits: int = 3) -> str:
    return f"{values.mean():.{digits}f} ±{values.std():.{digits}f}"


def as_json(results: Results) -> dict[str, Any]:
    """Everything as plain values, one entry per scene, with one number per seed."""
    return {
        "seeds": list(results.seeds),
        "setup": asdict(results.setup),
        "cases": [
            {
                "scene": case.scene,
                **{
                    f"{what}_links": asdict(count)
                    | finite_or_none({"precision": count.precision, "recall": count.recall})
                    for what in ("moving", "pure", "resting")
                    for count in [case.count(what)]
                },
                **{
                    what: {reading: case.scores(what, reading).tolist() for reading in _READINGS}
                    for what in ("nmi", "nmi_plain", "error_plain")
                },
            }
            for case in results.cases
        ],
    }
