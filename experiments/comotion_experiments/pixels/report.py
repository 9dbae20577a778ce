"""The benchmark as a table, in a terminal and in Markdown."""

from ..tables import Table
from .benchmark import LENGTHS, OURS, SETTINGS, Benchmark, Row

_LENGTH_TITLES = ("all frames", *(f"first {n}" for n in LENGTHS if n is not None))
TITLES = ("data set", "method", *_LENGTH_TITLES, "median", "NMI", "K exact", "ms")


def table(found: Benchmark) -> Table:
    """Build the table: mean error in per cent per length; the rest is of all frames."""
    by_method: dict[tuple[str, str], dict[int | None, Row]] = {}
    for row in found.rows:
        by_method.setdefault((row.data_set, row.method), {})[row.frames] = row
    drawn = Table(TITLES, words=2)
    for (name, method), lengths in by_method.items():
        drawn.add(
            f"{name} ({lengths[None].sequences})",
            method,
            *(f"{lengths[n].error:.1f}" for n in LENGTHS),
            f"{lengths[None].median_error:.1f}",
            f"{lengths[None].nmi:.3f}",
            f"{lengths[None].k_exact:.0f} %",
            f"{lengths[None].ms:.0f}" if method == OURS else "-",
            strong=method == OURS,
        )
    return drawn


def lines(found: Benchmark) -> list[str]:
    """Format the results that are not in the table."""
    good, count = found.singles
    texts = [
        f"{name}: {error:.1f} % with the parameters chosen on other scenes, among {len(SETTINGS)} settings"
        for name, error in found.cross_validated.items()
    ]
    if count:
        texts.append(f"Hopkins155, each motion alone: one hypothesis in {good} of {count}")
    return texts


def markdown(found: Benchmark) -> str:
    """Format the results as Markdown."""
    return table(found).markdown() + "\n\n" + "\n".join(f"- {line}" for line in lines(found)) + "\n"
