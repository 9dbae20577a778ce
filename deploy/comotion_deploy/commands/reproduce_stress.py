"""``comotion dev reproduce stress``: streams that are not clean, and how soon the methods get over it."""

import json
from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..errors import UserError
from .experiments import check, progress

EPILOG = """
Examples:

  comotion dev reproduce stress --quick

  comotion dev reproduce stress --out docs/research

  comotion dev reproduce stress --family restart --family cover --seeds 0,2 --method comotion

A family's name also stands for all that begin with it: cover for cover_1s and cover_3s.
"""


def stress(
    family: Annotated[
        list[str] | None,
        typer.Option("--family", metavar="NAME", help="Family of scenes; may be repeated. Default: all."),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds",
            envvar="COMOTION_SEEDS",
            help="Seeds, e.g. 1,3 or 0-4. Default: 1,3,5,7,9, quick 1; even ones are for development.",
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="comotion or thesis; may be repeated. Default: both."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One seed, no runs of ten minutes.")] = False,
    jobs: Annotated[int, typer.Option("--jobs", min=1, max=256, help="Processes at once.")] = 2,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where stress.md and images/stress.png go.")
    ] = Path("stress"),
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """How the methods get over restarts, covers, drift, rest and other trouble, on made-up scenes."""
    from rich.console import Console

    from comotion_experiments import stress as study
    from comotion_experiments.inputs import parse_seeds
    from comotion_experiments.stress import report

    check(out)
    chosen = parse_seeds(seeds) if seeds else study.REPORTED_SEEDS[: 1 if quick else None]
    unknown = [name for name in method or () if name not in study.METHODS]
    if unknown:
        raise UserError(f"method {unknown[0]!r} is none of {', '.join(study.METHODS)}")
    families = study.find_families(family or (), quick=quick)
    with progress() as note:
        results = study.run_experiment(
            families, chosen, methods=method or study.METHODS, jobs=jobs, progress=note
        )
    (out / "images").mkdir(parents=True, exist_ok=True)
    report.save_picture(out / "images" / "stress.png", results)
    (out / "stress.md").write_text(report.markdown(results, "images/stress.png"))
    if json_:
        print(json.dumps(report.as_json(results), indent=2))
        return
    console = Console(width=max(170, Console().width))
    for drawn in report.tables(results):
        console.print(drawn)
    print(f"written: {out / 'stress.md'}, {out / 'images' / 'stress.png'}")
