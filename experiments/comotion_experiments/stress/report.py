"""The results as a table, in a terminal and in Markdown, as plain values, and as a picture."""

import math
from dataclasses import asdict
from typing import Any

from rich.table import Table

from comotion_clients.scoring import finite_or_none

from .catalogue import FAMILIES
from .experiment import Figures, Results
from .metrics import mean

# Field of the figures, title, digits, factor.
_COLUMNS = (
    ("nmi_apart", "NMI", 3),
    ("all_bodies", "all bodies", 3),
    ("nmi", "by body", 3),
    ("delay", "delay", 2),
    ("healing", "healing", 2),
    ("healed_in_1s", "in 1 s", 2),
    ("kept", "kept", 2),
    ("wrong", "wrong", 2),
    ("ids", "ids", 2),
    ("spurious", "spurious", 1),
    ("true", "true", 1),
    ("switches", "switches", 1),
    ("hypotheses", "K", 2),
    ("bodies", "K true", 2),
    ("ms", "ms", 1),
)


def means(results: Results, family: str, method: str) -> dict[str, float]:
    """Mean of every metric over the seeds; NaN where it does not apply."""
    rows = [asdict(o.figures) for o in results.of(family, method)]
    return {name: mean([row[name] for row in rows]) for name in Figures.__dataclass_fields__}


def families_of(results: Results) -> list[str]:
    """Names of the families that were run, in the order of the catalogue."""
    ran = {o.family for o in results.outcomes}
    return [name for name in FAMILIES if name in ran]


def table(results: Results) -> Table:
    """For a terminal: a row for each family and method."""
    drawn = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    drawn.add_column("family", no_wrap=True)
    drawn.add_column("method", no_wrap=True)
    for _, title, _ in _COLUMNS:
        drawn.add_column(title, justify="right", no_wrap=True)
    for family in families_of(results):
        for method in results.methods:
            drawn.add_row(family, method, *_cells(means(results, family, method)))
    return drawn


def _cells(row: dict[str, float]) -> list[str]:
    return [_number(row[name], digits) for name, _, digits in _COLUMNS]


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def as_json(results: Results) -> dict[str, Any]:
    """Everything but the traces as plain values."""
    return {
        "seeds": list(results.seeds),
        "runs": [
            {
                "family": o.family,
                "method": o.method,
                "seed": o.seed,
                **finite_or_none(asdict(o.figures)),
            }
            for o in results.outcomes
        ],
    }
