"""``comotion dev reproduce figures``, also ``comotion dev reproduce``: the figures of the thesis."""

import json
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import options
from ..errors import UserError
from ..fusion_options import fusion_config
from .experiments import Cache, cache_folder, check, progress

if TYPE_CHECKING:
    from comotion_experiments.figures import Results

EPILOG = """
Examples:

  comotion dev reproduce --quick

  comotion dev reproduce --only 4.4 --only 4.5 --out figures

  comotion dev reproduce figures --only 4.1,4.2 --seeds 0-9 --json
"""


def figures(
    ctx: typer.Context,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only", metavar="FIGURE", help="Figure, e.g. 4.4; may be repeated. Default: all fifteen."
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds",
            envvar="COMOTION_SEEDS",
            help="Seeds of simulated scenes, e.g. 0-4 or 0,3. Default: 0-4, quick 0.",
        ),
    ] = None,
    workcell_seeds: Annotated[
        str | None,
        typer.Option("--workcell-seeds", help="Seeds of the workcell. Default: 0-1, quick 0."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One seed each and smaller camera images.")] = False,
    out: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Where index.html, figures.json and the pictures go."),
    ] = Path("figures"),
    cache: Cache = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Draw all figures of the thesis with the thesis method and the default method.

    Writes pictures and a page. Figures 4.6 to 4.11 need the workcell (extra sim3d).
    """
    from comotion_experiments.figures import Options, reproduce, select
    from comotion_experiments.figures.page import left_out, page
    from comotion_experiments.inputs import parse_seeds

    chosen = select(only)
    config = fusion_config(ctx, None, assignments)
    if config.method != "comotion":
        raise UserError(f"method {config.method!r}: the figures compare the default method with the thesis'")
    simulated = parse_seeds(seeds or ("0" if quick else "0-4"))
    filmed = parse_seeds(workcell_seeds or ("0" if quick else "0-1"))
    check(out)
    workcell = find_spec("mujoco") is not None
    if only and not workcell and all(figure.workcell for figure in chosen):
        raise UserError("mujoco is not installed: pip install 'comotion[sim3d]'")
    given = Options(simulated, filmed, quick, cache or cache_folder() / "figures", config)
    with progress() as note:
        results = reproduce(chosen, given, out, workcell=workcell, note=note)
    values = json.dumps(results.as_json(), indent=2)
    (out / "figures.json").write_text(values + "\n", encoding="utf-8")
    command = _command(only, seeds, workcell_seeds, assignments, quick=quick)
    (out / "index.html").write_text(page(results, command), encoding="utf-8")
    if json_:
        print(values)
        return
    _report(results, left_out(results), out)


def _command(
    only: list[str] | None,
    seeds: str | None,
    workcell_seeds: str | None,
    assignments: list[str] | None,
    *,
    quick: bool,
) -> str:
    """Return the command line that makes the same page."""
    words = ["comotion", "dev", "reproduce"]
    for name in only or ():
        words += ["--only", name]
    for option, value in (("--seeds", seeds), ("--workcell-seeds", workcell_seeds)):
        words += [option, value] if value else []
    words += ["--quick"] if quick else []
    for assignment in assignments or ():
        words += ["--set", assignment]
    return shlex.join(words)


def _report(results: "Results", left_out: str, out: Path) -> None:
    from rich.console import Console

    console = Console(width=max(150, Console().width))
    console.print(_table(results))
    if left_out:
        console.print(left_out, markup=False, highlight=False)
    console.print(f"written: {out / 'index.html'}, {out / 'figures.json'}", markup=False, highlight=False)


def _table(results: "Results") -> Any:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("figure", "", "the thesis says", "thesis method here", "default method here"):
        table.add_column(title)
    for made in results.made:
        for k, row in enumerate(made.rows):
            name = made.figure.name if k == 0 else ""
            table.add_row(name, row.quantity, row.printed, row.thesis, row.default)
        table.add_section()
    return table
