"""The results of image families as a table, for a terminal and in Markdown."""

from collections.abc import Sequence

from ..tables import Table, means, number
from .image_experiment import IMAGE_FAMILIES, ImageOutcome

# Field of the figures, title, digits, factor.
_COLUMNS = (
    ("error", "error, %", 1, 1.0),
    ("exact", "K exact, %", 0, 100.0),
    ("over", "K over, %", 0, 100.0),
    ("under", "K under, %", 0, 100.0),
    ("nmi", "NMI", 3, 1.0),
    ("given", "K given, %", 1, 1.0),
    ("one", "one, %", 1, 1.0),
)

_TEXT = """## Images

Bodies with depth seen by a perspective camera for 2 to 3 s, 0.3 px of noise, six sequences a family and seed;
the pixel method with K unknown, one update at the end. **Error**: misclassified features; those without a
hypothesis are wrong. **K given**: spectral clustering of shape interaction, which is given K. **one**: all
features are one object."""


def table(outcomes: Sequence[ImageOutcome]) -> Table:
    """Build a row for each family."""
    found = Table(("family", "what is seen", *(title for _, title, _, _ in _COLUMNS)), words=2)
    ran = {o.family for o in outcomes}
    for name in (one for one in IMAGE_FAMILIES if one in ran):
        row = means([o.figures for o in outcomes if o.family == name])
        cells = (number(factor * row[key], digits) for key, _, digits, factor in _COLUMNS)
        found.add(f"`{name}`", IMAGE_FAMILIES[name].title, *cells)
    return found


def markdown(outcomes: Sequence[ImageOutcome]) -> str:
    """For a document."""
    return f"{_TEXT}\n\n{table(outcomes).markdown()}"
