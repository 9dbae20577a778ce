"""``comotion dev bench``: time, memory and latency of the core on this machine."""

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .. import options
from ..fusion_options import fusion_config
from .experiments import check

if TYPE_CHECKING:
    from comotion_experiments.bench import Costs

EPILOG = """
Examples:

  comotion dev bench --quick

  comotion dev bench --features 500,1000,3000 --method thesis --updates 100

  comotion dev bench --features 1000 --rate 15,30,60 --recording tennis_serve.npz --json

  comotion dev bench --pixels --sources 1 --method comotion --features 500,1000   # one plain camera

  comotion dev bench --out docs/research   # writes performance.md and its picture

  comotion dev bench --live --features 1000 --seconds 60   # processes over a router: latency, overruns, CPU

  comotion dev bench --scaling --scenes 1,2,4 --features 42,100 --out docs   # many scenes, and standbys
"""


def bench(
    ctx: typer.Context,
    features: Annotated[
        str | None,
        typer.Option(
            "--features", help="Numbers of features. Default: 500,1000,3000,5000; quick 200,500; live 1000."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="Method; may be repeated. Default: comotion and thesis."),
    ] = None,
    rate: Annotated[str, typer.Option("--rate", help="Hz of every source; several make more rows.")] = "30",
    recording: Annotated[
        list[str] | None,
        typer.Option("--recording", metavar="FILE", help="Time a recording or sim:NAME too; repeatable."),
    ] = None,
    updates: Annotated[int | None, typer.Option("--updates", min=2, help="Updates to time per row.")] = None,
    bodies: Annotated[int, typer.Option("--bodies", min=1, help="Moving bodies of the scene.")] = 6,
    sources: Annotated[int, typer.Option("--sources", min=1, max=64, help="Sources of the scene.")] = 3,
    churn: Annotated[
        float, typer.Option("--churn", min=0, max=1, help="Share of the features replaced per second.")
    ] = 0.03,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the scene.")] = 0,
    pixels: Annotated[
        bool, typer.Option("--pixels", help="Plain cameras: a space in px for each of the sources.")
    ] = False,
    baseline: Annotated[
        int | None,
        typer.Option(
            "--baseline",
            min=0,
            help="Features for the straightforward version; 0: leave it out. Default: 1000, quick 200, px 0.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Small numbers, few updates.")] = False,
    live: Annotated[bool, typer.Option("--live", help="Measure processes over a router instead.")] = False,
    scaling: Annotated[
        bool, typer.Option("--scaling", help="Measure many scenes, with and without standbys, instead.")
    ] = False,
    scenes: Annotated[str, typer.Option("--scenes", help="Numbers of scenes of --scaling.")] = "1,2,4,8",
    seconds: Annotated[float, typer.Option("--seconds", min=1, help="Of --live and --scaling.")] = 30.0,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write performance.md and images/performance.png there."),
    ] = None,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Time the core on generated scenes of any size: ms per update, CPU, memory, and baselines."""
    from rich.console import Console

    # Threads of parallel kernels spin for some tens of microseconds before they sleep.
    os.environ.setdefault("GOMP_SPINCOUNT", "50000")
    if live:
        _live(features, method, seconds, assignments or [], as_json=json_)
        return
    if out is not None:
        check(out)
    if scaling:
        _scaling(scenes, features, method, seconds, assignments or [], out)
        return
    from comotion_experiments import bench as study

    spec = study.SceneSpec(bodies=bodies, sources=sources, churn=churn, seed=seed, pixels=pixels)
    sizes = _numbers("--features", features or ("200,500" if quick else "500,1000,3000,5000"), 2, 50_000)
    status = Console(stderr=True)
    costs = study.run_bench(
        study.scaled(spec, sizes, _numbers("--rate", rate, 1, 1000)),
        [fusion_config(ctx, name, assignments) for name in method or ("comotion", "thesis")],
        updates or (20 if quick else 100),
        recordings=recording or (),
        baseline=_baseline(quick, pixels) if baseline is None else baseline,
        progress=lambda what: status.print(what, style="dim", highlight=False),
    )
    _report(costs, out, as_json=json_)


def _report(costs: "Costs", out: Path | None, *, as_json: bool) -> None:
    from rich.console import Console

    from comotion_experiments.bench import report

    if out is not None:
        (out / "images").mkdir(parents=True, exist_ok=True)
        report.save_picture(out / "images" / "performance.png", costs)
        text = report.markdown(costs, "images/performance.png", _command())
        report.write_page(out / "performance.md", "core", text)
    if as_json:
        print(json.dumps(costs.as_json(), indent=2))
        return
    console = Console(width=max(120, Console().width))
    console.print(report.table(costs))
    for line in report.lines(costs):
        console.print(line, highlight=False)
    if out is not None:
        console.print(f"written: {out / 'performance.md'}", highlight=False)


def _command() -> str:
    """Return the command line; files without their folders, since the page is for other machines."""
    return " ".join(
        ["comotion", *(Path(word).name if Path(word).is_file() else word for word in sys.argv[1:])]
    )


def _live(
    features: str | None, method: list[str] | None, seconds: float, assignments: list[str], *, as_json: bool
) -> None:
    from ..bench_live import live_lines, run_live

    fusion = [word for name in method or () for word in ("--method", name)]
    fusion += [word for text in assignments for word in ("--set", text)]
    found = []
    for size in _numbers("--features", features or "1000", 2, 50_000):
        found.append(run_live(size, seconds, ["--set", f"max_tracks={max(5000, 2 * size)}", *fusion], 12.0))
        if not as_json:
            print("\n".join(live_lines(found[-1])))
    if as_json:
        print(json.dumps(found, indent=2))


def _scaling(
    scenes: str,
    features: str | None,
    method: list[str] | None,
    seconds: float,
    assignments: list[str],
    out: Path | None,
) -> None:
    """The same features in one scene and in many, with and without standbys."""
    from comotion_experiments.bench import report, scaling
    from comotion_experiments.bench.machine import describe_machine

    from ..bench_scaling import run_scaling

    counts = _numbers("--scenes", scenes, 1, 256)
    sizes = _numbers("--features", features or "100", 2, 50_000)
    loads = [load for size in sizes for load in scaling.loads(counts, size)]
    fusion = [word for name in method or () for word in ("--method", name)]
    fusion += [word for text in assignments for word in ("--set", text)]
    found = run_scaling(loads, seconds, fusion, lambda line: print(line, file=sys.stderr, flush=True))
    print(scaling.markdown(found))
    if out is not None:
        (out / "images").mkdir(parents=True, exist_ok=True)
        scaling.save_picture(out / "images" / "scaling.png", found)
        machine = describe_machine()
        where = f"{machine.processor}, {machine.cores} cores"
        text = f"`{_command()}`, {where}, comotion {machine.versions['comotion']}.\n\n"
        text += f"{scaling.markdown(found)}\n\n![Cores by kind](images/scaling.png)\n"
        report.write_page(out / "scaling.md", "scaling", text)


def _baseline(quick: bool, pixels: bool) -> int:
    if pixels:
        return 0
    return 200 if quick else 1000


def _numbers(option: str, text: str, least: int, most: int) -> list[int]:
    chunks = [chunk.strip() for chunk in text.split(",")]
    if not all(chunk.isdecimal() and least <= int(chunk) <= most for chunk in chunks):
        from comotion_schemas.errors import KnownError

        raise KnownError(f"{option} {text}: expected numbers from {least} to {most}, separated by commas")
    return [int(chunk) for chunk in chunks]
