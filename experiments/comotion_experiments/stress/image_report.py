"""The results of image families as a table, in Markdown and as plain values."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from rich.table import Table

from comotion_clients.scoring import finite_or_none

from .image_experiment import IMAGE_FAMILIES, ImageFigures, ImageOutcome
from .metrics import mean

# Field of the figures, title, digits, factor.
_COLUMNS = (
    ("error", "error, %", 1, 1.0),
    ("exact", "K exact, %", 0, 100.0),
    ("over", "K over, %", 0, 100.0),
    ("under", "K under, %", 0, 100.0),
    ("found", "K", 1, 1.0),
    ("true", "true K", 1, 1.0),
    ("nmi", "NMI", 3, 1.0),
    ("given", "K given, %", 1, 1.0),
    ("one", "one, %", 1, 1.0),
    ("ms", "ms", 0, 1.0),
)

_TEXT = """## Images

Bodies with depth seen by a perspective camera for 2 to 3 s, 0.3 px of noise, six sequences a family and seed;
the pixel method with K unknown, one update at the end. **Error**: misclassified features; those without a
hypothesis are wrong. **K given**: spectral clustering of shape interaction, which is given K. **one**: all
features are one object."""


def table(outcomes: Sequence[ImageOutcome]) -> Table:
    """For a terminal: a row for each family."""
    drawn = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    drawn.add_column("family", no_wrap=True)
    for _, title, _, _ in _COLUMNS:
        drawn.add_column(title, justify="right", no_wrap=True)
    for name in _names(outcomes):
        drawn.add_row(name, *_cells(outcomes, name))
    return drawn


def markdown(outcomes: Sequence[ImageOutcome]) -> str:
    """For a document."""
    lines = [
        _TEXT,
        "",
        "| family | what is seen | " + " | ".join(title for _, title, _, _ in _COLUMNS) + " |",
        "|---|---|" + "---:|" * len(_COLUMNS),
    ]
    lines += [
        f"| `{name}` | {IMAGE_FAMILIES[name].title} | " + " | ".join(_cells(outcomes, name)) + " |"
        for name in _names(outcomes)
    ]
    return "\n".join(lines)


def as_json(outcomes: Sequence[ImageOutcome]) -> list[dict[str, Any]]:
    """Plain values, an entry for each family and seed."""
    return [
        {"family": o.family, "seed": o.seed, **finite_or_none(asdict(o.figures)), "errors": o.errors}
        for o in outcomes
    ]


def _names(outcomes: Sequence[ImageOutcome]) -> list[str]:
    ran = {o.family for o in outcomes}
    return [name for name in IMAGE_FAMILIES if name in ran]


def _cells(outcomes: Sequence[ImageOutcome], family: str) -> list[str]:
    rows = [asdict(o.figures) for o in outcomes if o.family == family]
    means = {name: mean([row[name] for row in rows]) for name in ImageFigures.__dataclass_fields__}
    return [f"{factor * means[name]:.{digits}f}" for name, _, digits, factor in _COLUMNS]
