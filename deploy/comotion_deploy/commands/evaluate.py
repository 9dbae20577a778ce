"""``comotion evaluate``: scores of the hypotheses against the truth, live or offline."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import options
from ..errors import UserError, missing_extra
from ..fusion_options import fusion_config

if TYPE_CHECKING:
    from comotion_schemas.transport import SessionSettings

EPILOG = """
Examples:

  comotion evaluate --duration 30   # a running scene that publishes truth

  comotion evaluate recording.npz --method thesis --set thesis.sigma_switch=0.01

  comotion evaluate sim:fig4_4 sim:fig4_1 --seeds 0-4 --period 0.333 --json

  comotion evaluate sim:3d_3 --compare   # with a comparator

  comotion evaluate take.mcap   # what comotion record has written

  comotion evaluate take.mcap --paths out && evo_traj tum out/*.tum   # evo draws and compares them

  comotion evaluate recording.npz --split 3 --plot out/recording.png
"""

_OFFLINE_ONLY = ("method", "assignments", "period", "seeds", "split", "rate", "as_received", "compare")
_LIVE_ONLY = ("scene", "connect", "ready_file")


def evaluate(
    ctx: typer.Context,
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[FILES]...",
            help="Recordings (.c3d, .npz, .mcap) and simulated scenes (sim:NAME). "
            "Without any: the running scene.",
            show_default=False,
        ),
    ] = None,
    method: options.Method = None,
    assignments: options.Assignments = None,
    period: Annotated[
        float | None,
        typer.Option(
            "--period",
            envvar="COMOTION_PERIOD",
            help="s between updates. Default: the fusion parameter.",
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration",
            envvar="COMOTION_DURATION",
            help="s to evaluate. Default: to the end; live: until Ctrl-C.",
        ),
    ] = None,
    seeds: Annotated[
        str,
        typer.Option("--seeds", envvar="COMOTION_SEEDS", help="Seeds of simulated scenes, e.g. 0-4 or 0,3."),
    ] = "0",
    split: Annotated[
        int,
        typer.Option(
            "--split",
            envvar="COMOTION_SPLIT_SOURCES",
            min=1,
            max=64,
            help="Divide a recording among so many sources.",
        ),
    ] = 1,
    rate: Annotated[
        str | None,
        typer.Option(
            "--rate", envvar="COMOTION_RATE", metavar="HZ[,HZ...]", help="Rate of the sources, or of each."
        ),
    ] = None,
    as_received: Annotated[
        bool,
        typer.Option(
            "--as-received",
            envvar="COMOTION_AS_RECEIVED",
            help="Process recorded scenes (.mcap) in the order of receipt, including late data. "
            "Default: in the order of acquisition.",
        ),
    ] = False,
    compare: Annotated[
        bool,
        typer.Option(
            "--compare",
            envvar="COMOTION_COMPARE",
            help="Score the affinity of Brox and Malik as well, with spectral clustering (number of objects "
            "given) and with divisive k-means.",
        ),
    ] = False,
    plot: Annotated[
        Path | None,
        typer.Option(
            "--plot", envvar="COMOTION_PLOT", metavar="FILE.png", help="Draw hypotheses, truth and NMI."
        ),
    ] = None,
    paths: Annotated[
        Path | None,
        typer.Option(
            "--paths",
            envvar="COMOTION_PATHS",
            metavar="FOLDER",
            help="Write the paths of moving cameras and of bodies in the TUM format, for evo.",
        ),
    ] = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    json_: options.Json = False,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Score hypotheses against the truth: NMI, error, number of hypotheses, switches, HOTA, IDF1.

    Every track that is observed at an update is scored; a track that is undetermined
    or not in the update counts as a separate cluster.
    """
    _check_duration(duration)
    if plot is not None:
        _require_matplotlib()
    if files:
        options.reject_flags(ctx, _LIVE_ONLY, "is only for a running scene, without FILES")
    else:
        options.reject_flags(ctx, _OFFLINE_ONLY, "is only for FILES")
    if not files:
        _live(
            scene, options.session_settings(connect, tls=tls), duration, plot, paths, ready_file, json_=json_
        )
        return
    from rich.console import Console

    from comotion.library.compiling import report_compiling
    from comotion_experiments.evaluate import as_json, evaluate_inputs, plot_path, table
    from comotion_experiments.inputs import find_inputs, parse_seeds
    from comotion_sources.parts import parse_rates

    config = fusion_config(ctx, method, assignments)
    report_compiling()
    rates = parse_rates(rate) if rate else None
    try:
        inputs = find_inputs(
            files, seeds=parse_seeds(seeds), split=split, rates=rates, as_received=as_received
        )
    except ImportError as error:
        raise missing_extra("record", error) from None
    results = evaluate_inputs(
        inputs, config, period=period, duration=duration, plot=plot, paths=paths, comparator=compare
    )
    if json_:
        _print_json(as_json(results, config, period))
    else:
        Console(width=None if sys.stdout.isatty() else 120).print(table(results))
        if plot is not None:
            for one in inputs:
                _print_plot_path(plot_path(plot, one, several=len(inputs) > 1))


def _live(
    scene: str,
    settings: "SessionSettings",
    duration: float | None,
    plot: Path | None,
    paths: Path | None,
    ready_file: Path | None,
    *,
    json_: bool,
) -> None:
    from comotion_clients.evaluate import EvaluateOptions, as_json, evaluate, summary_lines
    from comotion_clients.tum import save_paths
    from comotion_experiments.plot import Trace, save_plot

    trace = Trace()
    how = EvaluateOptions(duration=duration, on_update=trace.add, ready_file=ready_file)
    run = evaluate(scene, settings, how)
    if paths is not None:
        save_paths(paths, trace.updates)
    if plot is not None:
        save_plot(
            plot,
            title=f"scene {scene}, live",
            updates=trace.updates,
            scores=run.scores,
            truth=run.truth,
            spaces=run.spaces,
        )
    if json_:
        _print_json(as_json(run))
        return
    for line in summary_lines(run):
        print(line)
    _print_plot_path(plot)


def _check_duration(duration: float | None) -> None:
    if duration is not None and not 0 < duration < float("inf"):
        raise UserError(f"--duration {duration:g} is not above 0")


def _require_matplotlib() -> None:
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise UserError("matplotlib is not installed: pip install 'comotion[plot]'")


def _print_plot_path(plot: Path | None) -> None:
    if plot is not None:
        print(f"plot: {plot}")


def _print_json(values: dict[str, Any]) -> None:
    import json

    print(json.dumps(values, indent=2))
