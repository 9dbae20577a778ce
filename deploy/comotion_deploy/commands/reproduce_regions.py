"""``comotion dev reproduce regions``: dense regions of an image from labelled features."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..errors import require_dense
from ..fusion_options import fusion_config
from .experiments import check_folder, progress, write_report

EPILOG = """
Examples:

  comotion dev reproduce regions --quick

  comotion dev reproduce regions --seeds 1,3,5 --workcell shelf --out regions
"""


def regions(
    ctx: typer.Context,
    workcell: Annotated[
        list[str] | None,
        typer.Option(
            "--workcell", metavar="SCENE", help="Workcell scene; may be repeated. Default: shelf, truck, arm."
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds", envvar="COMOTION_SEEDS", help="Seeds, e.g. 1,3 or 0-4. Default: 0-4, quick 0."
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="One seed, 6 s of each scene.")] = False,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where regions.md and regions.json go.")
    ] = Path("regions"),
    method: options.Method = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Measure how well dense regions cover the true objects of the workcell (IoU)."""
    require_dense()
    from comotion_experiments.inputs import parse_seeds
    from comotion_experiments.regions import experiment as study
    from comotion_experiments.regions import report

    check_folder(out)
    config = fusion_config(ctx, method, assignments)
    numbers = parse_seeds(seeds or ("0" if quick else "0-4"))
    with progress() as note:
        results = study.run_experiment(
            workcell or study.SCENES, numbers, config, duration=6.0 if quick else None, progress=note
        )
    text = report.markdown(results)
    values, written = write_report(out, "regions", text, report.as_json(results))
    print(values if json_ else f"{text}\n{written}")
