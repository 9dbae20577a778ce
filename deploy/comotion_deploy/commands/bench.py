"""``comotion bench``: what an update costs on this machine."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from .. import options

EPILOG = """
Examples:

  comotion bench --quick

  comotion bench --features 500,1000,3000 --method thesis --updates 100

  comotion bench --features 1000 --method comotion --method thesis --set period=0.25 --json
"""


def bench(
    ctx: typer.Context,
    features: Annotated[
        str | None,
        typer.Option("--features", help="Numbers of features. Default: 500,1000,3000,5000; quick 200,500."),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option("--method", help="Method; may be repeated. Default: comotion and thesis."),
    ] = None,
    updates: Annotated[int | None, typer.Option("--updates", min=2, help="Updates to time per row.")] = None,
    bodies: Annotated[int, typer.Option("--bodies", min=1, help="Moving bodies of the scene.")] = 6,
    sources: Annotated[int, typer.Option("--sources", min=1, max=64, help="Sources of the scene.")] = 3,
    rate: Annotated[float, typer.Option("--rate", min=1, max=1000, help="Hz of every source.")] = 30.0,
    churn: Annotated[
        float, typer.Option("--churn", min=0, max=1, help="Share of the features replaced per second.")
    ] = 0.03,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the scene.")] = 0,
    quick: Annotated[bool, typer.Option("--quick", help="Small numbers, few updates.")] = False,
    assignments: options.Assignments = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Time the core on a made-up scene: ms per update with its share of ingest, CPU and memory."""
    from rich.console import Console

    from comotion_experiments import bench as study
    from comotion_experiments.bench.report import table

    sizes = _numbers(features or ("200,500" if quick else "500,1000,3000,5000"))
    spec = study.SceneSpec(bodies=bodies, sources=sources, rate=rate, churn=churn, seed=seed)
    status = Console(stderr=True)
    rows = study.run_bench(
        study.scaled(spec, sizes),
        [options.fusion_config(ctx, name, assignments) for name in method or ("comotion", "thesis")],
        updates or (20 if quick else 60),
        progress=lambda what: status.print(what, style="dim", highlight=False),
    )
    if json_:
        print(json.dumps([asdict(row) for row in rows], indent=2))
    else:
        Console(width=max(100, Console().width)).print(table(rows))


def _numbers(text: str) -> list[int]:
    chunks = [chunk.strip() for chunk in text.split(",")]
    if not all(chunk.isdecimal() and 2 <= int(chunk) <= 50_000 for chunk in chunks):
        raise ValueError(f"--features {text}: expected numbers from 2 to 50000, separated by commas")
    return [int(chunk) for chunk in chunks]
