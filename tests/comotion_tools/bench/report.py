"""The benchmark as a table, as Markdown and as a picture."""

import sys
from pathlib import Path

from comotion_experiments.plot import new_figure
from comotion_experiments.tables import Column, Table
from comotion_schemas.errors import KnownError

from .experiment import Costs

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
_COLUMNS = (
    Column("features", "N", 0),
    Column("rate", "Hz", 0),
    Column("period", "period", 0, 1e3),
    Column("median_ms", "ms", 1),
    Column("p99_ms", "p99", 1),
    Column("ingest_ms", "ingest", 1),
    Column("cpu_ms", "CPU ms", 1),
    Column("cpu_share", "CPU", 0, 100.0, " %"),
    Column("memory_mb", "MB", 0),
    Column("nmi", "NMI", 3),
)


def table(costs: Costs) -> Table:
    """Build a line for each scene and method."""
    found = Table(("scene", "method", *(column.title for column in _COLUMNS)), words=2)
    for row in costs.rows:
        found.add(row["scene"], row["method"], *(column.of(row) for column in _COLUMNS))
    return found


def lines(costs: Costs) -> list[str]:
    """Format the results that are not in the table."""
    machine = costs.machine
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    return [
        f"{machine['processor']}, {machine['cores']} cores, load {machine['load']:.1f}; {versions}",
        *(f"{method}: cost grows as N to the {power:.2f}" for method, power in costs.exponents().items()),
    ]


def save(folder: Path, costs: Costs) -> Path:
    """Write the measured part of the page and its picture; the page, between whose marks it stands.

    Raises
    ------
    KnownError
        If the page has no marks.
    """
    page, picture = folder / "performance.md", "images/performance.png"
    (folder / picture).parent.mkdir(parents=True, exist_ok=True)
    save_picture(folder / picture, costs)
    # Files without their folders, since the page is for other machines.
    words = [Path(word).name if Path(word).is_file() else word for word in sys.argv[1:]]
    listed = "\n".join(f"- {line}" for line in lines(costs))
    made, drawn = " ".join(["comotion", *words]), table(costs).markdown()
    begin, end = "<!-- core: begin -->", "<!-- core: end -->"
    old = page.read_text(encoding="utf-8") if page.exists() else f"# Performance\n\n{begin}\n{end}\n"
    if begin not in old or end not in old:
        raise KnownError(f"{page}: has no marks '{begin}' and '{end}'")
    head, tail = old.split(begin)[0], old.split(end)[1]
    text = f"Made by `{made}`.\n\n{listed}\n\n{drawn}\n\n![cost against N]({picture})\n"
    page.write_text(f"{head}{begin}\n{text}{end}{tail}", encoding="utf-8")
    return page


def save_picture(path: Path, costs: Costs) -> None:
    """Draw the cost against the number of features, with the fitted power."""
    figure = new_figure(6, 4.5)
    axes = figure.subplots()
    powers = costs.exponents()
    for colour, method in zip(_COLOURS, dict.fromkeys(row["method"] for row in costs.rows), strict=False):
        rows = costs.scenes(method)
        label = method + (f", N^{powers[method]:.2f}" if method in powers else "")
        size, middle = [row["features"] for row in rows], [row["median_ms"] for row in rows]
        axes.plot(size, middle, marker="o", color=colour, label=label)
        axes.fill_between(size, middle, [row["p99_ms"] for row in rows], color=colour, alpha=0.2)
    axes.set(
        xscale="log", yscale="log", xlabel="features N", ylabel="ms per update (line: median, band: to p99)"
    )
    sizes = sorted({row["features"] for row in costs.rows if row["scene"] == "made up"})
    axes.set_xticks(sizes, [str(n) for n in sizes])
    axes.minorticks_off()
    axes.grid(visible=True, alpha=0.3)
    axes.legend()
    figure.savefig(path)
