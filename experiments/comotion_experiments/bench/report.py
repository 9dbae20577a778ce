"""The costs as a table."""

from collections.abc import Sequence

from rich.table import Table

from .experiment import Row

TITLES = ("method", "N", "Hz", "ms", "p99", "ingest", "CPU ms", "CPU", "MB", "NMI")


def cells(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Rows of the table: median and 99th percentile of ms per update, of it ingest, share of one core."""
    return [
        (
            row.method,
            f"{row.features}",
            f"{row.rate:g}",
            f"{row.median_ms:.1f}",
            f"{row.p99_ms:.1f}",
            f"{row.ingest_ms:.1f}",
            f"{row.cpu_ms:.1f}",
            f"{100 * row.cpu_share:.0f} %",
            f"{row.memory_mb:.0f}",
            f"{row.nmi:.3f}",
        )
        for row in rows
    ]


def table(rows: Sequence[Row]) -> Table:
    """For a terminal."""
    drawn = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for k, title in enumerate(TITLES):
        drawn.add_column(title, justify="left" if k == 0 else "right", no_wrap=True)
    for row in cells(rows):
        drawn.add_row(*row)
    return drawn
