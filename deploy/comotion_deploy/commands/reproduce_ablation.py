"""``comotion reproduce ablation``: what each rule of the default method is worth."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from .experiments import check_folder, known_parts, progress, write_report

EPILOG = """
Examples:

  comotion reproduce ablation --data recordings/mocap --out docs/research

  comotion reproduce ablation --rule stay --rule sliding --family sliding --seeds 0,2

A family's name also stands for all that begin with it.
"""


def ablation(
    rule: Annotated[
        list[str] | None,
        typer.Option("--rule", metavar="NAME", help="Rule to leave out; may be repeated. Default: each."),
    ] = None,
    family: Annotated[
        list[str] | None,
        typer.Option("--family", metavar="NAME", help="Stress family; may be repeated. Default: all."),
    ] = None,
    seeds: Annotated[
        str, typer.Option("--seeds", envvar="COMOTION_SEEDS", help="Seeds, e.g. 1,3 or 0-4.")
    ] = "1,3",
    data: Annotated[
        list[Path] | None,
        typer.Option("--data", metavar="DIR", help="Folder of labelled recordings; may be repeated."),
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, max=256, help="Processes at once.")] = 2,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where ablation.md and ablation.json go.")
    ] = Path("ablation"),
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Leave out each rule of the default method alone, on stress families and recordings."""
    from comotion_experiments.ablation import report
    from comotion_experiments.ablation.experiment import run_experiment
    from comotion_experiments.ablation.rules import RULES
    from comotion_experiments.inputs import parse_seeds
    from comotion_experiments.stress import FAMILIES, find_families

    check_folder(out)
    rules = known_parts(rule, list(RULES)) or list(RULES)
    found = find_families(family or (), quick=not family)
    families = [one.name for one in found if one.name in FAMILIES]
    with progress() as note:
        results = run_experiment(rules, families, parse_seeds(seeds), data or (), jobs=jobs, progress=note)
    text = report.markdown(results)
    values, written = write_report(out, "ablation", text, report.as_json(results))
    print(values if json_ else f"{text}\n{written}")
