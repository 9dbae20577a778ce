"""``comotion dev reproduce links``: the gain of linking a camera without depth to bodies in 3-D."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..fusion_options import fusion_config
from .experiments import Cache, Period, cache_folder, check_folder, progress, write_report

EPILOG = """
Examples:

  comotion dev reproduce links --quick

  comotion dev reproduce links --seeds 2-6 --out links

  comotion dev reproduce links --workcell shelf --turned 2 --json
"""


def links(
    ctx: typer.Context,
    workcell: Annotated[
        list[str] | None,
        typer.Option(
            "--workcell", metavar="SCENE", help="Workcell scene; may be repeated. Default: six of them."
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds", envvar="COMOTION_SEEDS", help="Seeds, e.g. 2-4 or 2,5. Default: 2-4, quick 2."
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small images, short runs, one seed.")] = False,
    period: Period = 1 / 3,
    turned: Annotated[
        float,
        typer.Option("--turned", metavar="DEGREES", min=-180, max=180, help="Error of the calibration."),
    ] = 0.0,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where links.md, links.json and links.jpg go.")
    ] = Path("links"),
    cache: Cache = None,
    method: options.Method = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Measure the gain of linking hypotheses of a camera without depth to bodies of a depth camera."""
    from rich.console import Console

    from comotion_experiments import links as study
    from comotion_experiments.inputs import parse_seeds
    from comotion_experiments.links import report

    check_folder(out)
    scenes = workcell or study.SCENES
    numbers = parse_seeds(seeds or ("2" if quick else "2-4"))
    config = fusion_config(ctx, method, assignments)
    setup, kept = study.QUICK if quick else None, cache or cache_folder() / "links"
    with progress() as note:
        results = study.run_experiment(
            scenes, numbers, config, setup=setup, cache=kept, period=period, turned=turned, progress=note
        )
    values, written = write_report(out, "links", report.markdown(results), report.as_json(results))
    study.save_picture(out / "links.jpg", scenes[0], numbers[0], config, setup=setup, cache=kept)
    if json_:
        print(values)
        return
    console = Console(width=max(170, Console().width))
    console.print(report.table(results))
    console.print(written, highlight=False)
