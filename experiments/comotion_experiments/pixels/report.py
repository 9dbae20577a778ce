"""The benchmark as a table, in a terminal and in Markdown."""

from rich.table import Table

from .benchmark import LENGTHS, OURS, Benchmark, Row

_LENGTH_TITLES = ("all frames", *(f"first {n}" for n in LENGTHS if n is not None))
TITLES = ("data set", "method", *_LENGTH_TITLES, "median", "NMI", "K exact", "ms")


def cells(found: Benchmark) -> list[tuple[str, ...]]:
    """Rows of the table: mean error in per cent per length; the rest is of all frames."""
    by_method: dict[tuple[str, str], dict[int | None, Row]] = {}
    for row in found.rows:
        by_method.setdefault((row.data_set, row.method), {})[row.frames] = row
    return [
        (
            f"{name} ({lengths[None].sequences})",
            method,
            *(f"{lengths[n].error:.1f}" for n in LENGTHS),
            f"{lengths[None].median_error:.1f}",
            f"{lengths[None].nmi:.3f}",
            f"{lengths[None].k_exact:.0f} %",
            f"{lengths[None].ms:.0f}" if method == OURS else "-",
        )
        for (name, method), lengths in by_method.items()
    ]


def lines(found: Benchmark) -> list[str]:
    """Format the results that are not in the table."""
    good, count = found.singles
    texts = [
        f"{name}: {first:.1f} % on every other scene by name, {second:.1f} % on the rest"
        for name, (first, second) in found.halves.items()
    ]
    if count:
        texts.append(f"Hopkins155, each motion alone: one hypothesis in {good} of {count}")
    return texts


def table(found: Benchmark) -> Table:
    """Build the table for a terminal."""
    drawn = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for k, title in enumerate(TITLES):
        drawn.add_column(title, justify="left" if k < 2 else "right", no_wrap=True)
    for row in cells(found):
        drawn.add_row(*row, style="bold" if row[1] == OURS else None)
    return drawn


def markdown(found: Benchmark) -> str:
    """Format the results as Markdown."""
    rows = [TITLES, ("---", "---", *["---:"] * (len(TITLES) - 2)), *cells(found)]
    text = "\n".join("| " + " | ".join(row) + " |" for row in rows)
    return text + "\n\n" + "\n".join(f"- {line}" for line in lines(found)) + "\n"
