"""``comotion dev reproduce joints``: joints between bodies, and a camera that moves."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from .experiments import Cache, cache_folder, check_folder, known_parts, progress, write_report

EPILOG = """
Examples:

  comotion dev reproduce joints --quick

  comotion dev reproduce joints --seeds 1,3,5 --data recordings/mocap --out joints

  comotion dev reproduce joints --part poses --part free --json
"""


def joints(
    part: Annotated[
        list[str] | None,
        typer.Option(
            "--part",
            metavar="PART",
            help="poses, features, sparse, free, people, cost or hand; may be repeated. Default: all.",
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds", envvar="COMOTION_SEEDS", help="Seeds, e.g. 1,3 or 0-4. Default: 1,3,5, quick 1."
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="One seed, ten of the poses, nothing that is rendered.")
    ] = False,
    data: Annotated[
        Path | None,
        typer.Option("--data", metavar="DIR", help="Folder of labelled .npz recordings of people."),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where joints.md and joints.json go.")
    ] = Path("joints"),
    cache: Cache = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Measure joints on poses, features and recordings, their cost, and a camera in a robot's hand."""
    from comotion_experiments.inputs import parse_seeds
    from comotion_experiments.joints import experiment as study
    from comotion_experiments.joints import report

    check_folder(out)
    rendered = ("features", "sparse", "hand")
    chosen = known_parts(part, study.PARTS) or [one for one in study.PARTS if not (quick and one in rendered)]
    numbers = parse_seeds(seeds or ("1" if quick else "1,3,5"))
    wanted = study.Experiment(chosen, numbers, 10 if quick else 50, data, cache or cache_folder() / "joints")
    with progress() as note:
        results = study.run_experiment(wanted, progress=note)
    text = report.markdown(results)
    values, written = write_report(out, "joints", text, report.as_json(results))
    print(values if json_ else f"{text}\n{written}")
