"""The link experiment as a table and as JSON."""

from typing import Any

from ..tables import Table, number, plain, spread
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
    """One row per scene, the last of all: means and, after ±, the spread over seeds."""
    found = Table(HEADINGS)
    for case in [*results.cases, results.all()]:
        found.add(*_cells(case))
    return found


def markdown(results: Results) -> str:
    """The same as a table for the documentation."""
    return table(results).markdown() + "\n"


def _cells(case: Case) -> list[str]:
    return [
        case.scene,
        _links(case, "moving"),
        _links(case, "pure"),
        _links(case, "resting"),
        *(spread(case.scores("nmi", reading)) for reading in _READINGS),
        *(spread(case.scores("nmi_plain", reading)) for reading in ("apart", "joined")),
        *(spread(100 * case.scores("error_plain", reading), 1) for reading in ("apart", "joined")),
    ]


def _links(case: Case, what: str) -> str:
    """Precision, recall and how many could be linked."""
    count = case.count(what)
    return f"{number(100 * count.precision, 0)}/{number(100 * count.recall, 0)} ({count.linkable})"


def as_json(results: Results) -> Any:
    """Everything as plain values, one entry per scene, with one number per seed."""
    cases: list[dict[str, Any]] = []
    for case in results.cases:
        counts = {what: case.count(what) for what in ("moving", "pure", "resting")}
        links = {
            f"{what}_links": {**vars(count), "precision": count.precision, "recall": count.recall}
            for what, count in counts.items()
        }
        scores = {
            what: {reading: case.scores(what, reading) for reading in _READINGS}
            for what in ("nmi", "nmi_plain", "error_plain")
        }
        cases.append({"scene": case.scene, **links, **scores})
    return plain({"seeds": results.seeds, "setup": results.setup, "cases": cases})
