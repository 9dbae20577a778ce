"""``comotion dev reproduce``: runs the experiments of the project."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from .. import options
from ..fusion_options import fusion_config
from . import (
    reproduce_ablation,
    reproduce_figures,
    reproduce_joints,
    reproduce_links,
    reproduce_regions,
    reproduce_stress,
)
from .experiments import Cache, Period, cache_folder, check, check_folder, known_parts, progress, write_report

if TYPE_CHECKING:
    from comotion_experiments.fusion import Results

FUSION_EPILOG = """
Examples:

  comotion dev reproduce fusion --quick

  comotion dev reproduce fusion --seeds 0-4 --out fusion

  comotion dev reproduce fusion --workcell shelf --method thesis --set thesis.sigma_switch=0.04 --json
"""

PIXELS_EPILOG = """
Examples:

  comotion dev reproduce pixels --data recordings --out pixels

  comotion dev reproduce pixels --data recordings --no-baselines --json

The folder has one or more of hopkins155/, kt3dmoseg/, mtpv/ and video/ikeasmall01.npz.
"""

ACCURACY_EPILOG = """
Examples:

  comotion dev reproduce accuracy --data recordings/mocap --out docs/research

  comotion dev reproduce accuracy --quick

  comotion dev reproduce accuracy --part comparator --data recordings/mocap   # Brox and Malik's affinity
"""

EPILOG = """
Examples:

  comotion dev reproduce --quick

  comotion dev reproduce figures --help

  comotion dev reproduce fusion --quick
"""


class _FiguresByDefault(TyperGroup):
    """Uses ``figures`` if no command is given."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args or (args[0].startswith("-") and args[0] not in ctx.help_option_names):
            args = ["figures", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_FiguresByDefault,
    help="Run the project's experiments again. Without a command: the figures of the thesis.",
    epilog=EPILOG,
)
app.command("figures", epilog=reproduce_figures.EPILOG)(reproduce_figures.figures)
app.command("joints", epilog=reproduce_joints.EPILOG)(reproduce_joints.joints)
app.command("links", epilog=reproduce_links.EPILOG)(reproduce_links.links)
app.command("regions", epilog=reproduce_regions.EPILOG)(reproduce_regions.regions)
app.command("ablation", epilog=reproduce_ablation.EPILOG)(reproduce_ablation.ablation)
app.command("stress", epilog=reproduce_stress.EPILOG)(reproduce_stress.stress)


@app.command("fusion", epilog=FUSION_EPILOG)
def fusion(
    ctx: typer.Context,
    workcell: Annotated[
        list[str] | None,
        typer.Option(
            "--workcell", metavar="SCENE", help="Workcell scene; may be repeated. Default: the four."
        ),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds", envvar="COMOTION_SEEDS", help="Seeds, e.g. 0-4 or 0,3. Default: 0-4, quick 0-1."
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Small images, short runs, two scenes, two seeds.")
    ] = False,
    period: Period = 1 / 3,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where fusion.md, .png and .json go.")
    ] = Path("fusion"),
    cache: Cache = None,
    method: options.Method = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Measure the gain of fusing cameras and robot joints, with camera A open and covered."""
    from comotion_experiments.fusion import QUICK, SCENES, Setup, run_experiment
    from comotion_experiments.inputs import parse_seeds

    check(out)
    results = run_experiment(
        workcell or (SCENES[:2] if quick else SCENES),
        parse_seeds(seeds or ("0-1" if quick else "0-4")),
        fusion_config(ctx, method, assignments),
        setup=QUICK if quick else Setup(),
        cache=cache or cache_folder() / "fusion",
        period=period,
    )
    _report(results, out, as_json=json_)


@app.command("pixels", epilog=PIXELS_EPILOG)
def pixels(
    data: Annotated[
        Path,
        typer.Option("--data", metavar="DIR", envvar="COMOTION_DATA", help="Folder of the recordings."),
    ],
    quick: Annotated[bool, typer.Option("--quick", help="As --no-baselines.")] = False,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where pixels.md and pixels.json go.")
    ] = Path("pixels"),
    baselines: Annotated[bool, typer.Option(help="Run the baselines too.")] = True,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Score the grouping of image features on labelled recordings, with baselines that know K."""
    from rich.console import Console

    from comotion_experiments.pixels import find_data_sets, report, run_benchmark

    check_folder(out)
    with progress() as note:
        found = run_benchmark(
            find_data_sets(data),
            baselines=baselines and not quick,
            progress=note,
        )
    values, written = write_report(out, "pixels", report.markdown(found), found.as_json())
    if json_:
        print(values)
        return
    console = Console(width=max(130, Console().width))
    console.print(report.table(found))
    for line in report.lines(found):
        console.print(line, highlight=False)
    console.print(written, highlight=False)


@app.command("accuracy", epilog=ACCURACY_EPILOG)
def accuracy(
    data: Annotated[
        Path | None,
        typer.Option("--data", metavar="DIR", help="Folder of labelled .npz recordings. Default: none."),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds",
            envvar="COMOTION_SEEDS",
            help="Seeds of simulated scenes, e.g. 0-4 or 0,3. Default: 0-4, quick 0.",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="One seed, the scenes of the thesis, as --no-robustness.")
    ] = False,
    robustness: Annotated[bool, typer.Option(help="Halve and double every parameter too.")] = True,
    part: Annotated[
        list[str] | None,
        typer.Option(
            "--part",
            metavar="PART",
            help="scores, comparator, motion or robustness; may be repeated. Default: all.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Where accuracy.md and its picture go.")
    ] = Path("accuracy"),
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Compare the accuracy of the default method and the thesis method on scenes and recordings."""
    from comotion_experiments import accuracy as study
    from comotion_experiments.accuracy import report
    from comotion_experiments.inputs import parse_seeds

    check(out)
    cases = study.scene_cases()
    most = [one for one in study.PARTS if one != "robustness" or (robustness and not quick)]
    parts = known_parts(part, study.PARTS) or most
    cases = [c for c in cases if c.group == "thesis scenes"] if quick else cases + study.displaced_cases()
    cases += study.recorded_cases(data) if data is not None else []
    experiment = study.Experiment(cases, parse_seeds(seeds or ("0" if quick else "0-4")), parts)
    with progress() as note:
        results = study.run_experiment(experiment, progress=note)
    out.mkdir(parents=True, exist_ok=True)
    if "scores" in parts:
        (out / "images").mkdir(exist_ok=True)
        report.save_reliability(out / "images" / "reliability.png", results)
    (out / "accuracy.md").write_text(report.markdown(results, "images/reliability.png"))
    print(f"written: {out / 'accuracy.md'}")


def _report(results: "Results", out: Path, *, as_json: bool) -> None:
    from rich.console import Console

    from comotion_experiments.fusion import report

    report.save_picture(out / "fusion.png", results)
    values, written = write_report(
        out, "fusion", report.markdown(results, "fusion.png"), report.as_json(results)
    )
    if as_json:
        print(values)
        return
    console = Console(width=max(110, Console().width))
    console.print(report.table(results))
    for line in report.lines(results):
        console.print(line, highlight=False)
    console.print(f"{written}, {out / 'fusion.png'}", highlight=False)
