"""``comotion demo``: a complete system in one command."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .. import options

EPILOG = """
Examples:

  comotion demo

  comotion demo --duration 60 --out /tmp/demo

  comotion demo fig4_4 --method thesis

  comotion demo 3d_outliers
"""

_THESIS_FIG_4_4 = ("thesis.sigma_switch=0.01", "thesis.v_move=null")
"""Parameters of figure 4.4 in the thesis: σ_switch 0.01 and equal weights."""


def demo(
    simulated: Annotated[
        str,
        typer.Argument(
            metavar="[SCENE]", help="A scene of the simulator; see 'comotion source simulator --list'."
        ),
    ] = "3d_async",
    duration: Annotated[float, typer.Option("--duration", min=1, help="s to run.")] = 30.0,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", file_okay=False, help="Where results and log go.")
    ] = Path("out"),
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the simulator.")] = 0,
    method: options.Method = None,
    assignments: options.Assignments = None,
    _log_level: options.Log = options.LogLevel.INFO,
) -> None:
    """Run router, three simulated sources, the service and watch; end with a summary and a plot."""
    from ..demo import (
        DemoOptions,
        demo_processes,
        free_endpoint,
        prepare,
        show_summary,
        time_scale,
        without_other_scenes,
    )
    from ..launcher import launch

    as_in_thesis = method == "thesis" and simulated == "fig4_4"
    settings = assignments or (_THESIS_FIG_4_4 if as_in_thesis else ())
    fusion = [word for setting in settings for word in ("--set", setting)]
    fusion += ["--method", method] if method else []
    how = DemoOptions(simulated=simulated, duration=duration, seed=seed, fusion=fusion, out=out)
    scale = time_scale(how)
    if ignored := without_other_scenes():
        print(f"the demo has a router of its own and does not use {', '.join(ignored)}", flush=True)
    out.mkdir(parents=True, exist_ok=True)
    for name in ("demo.state", "summary.txt", "demo.png", "demo.json"):
        (out / name).unlink(missing_ok=True)
    print(f"{simulated} for {duration:g} s; Ctrl-C ends it earlier; results go to {out}", flush=True)
    print("preparing; the first time on a machine this compiles for a minute or two", flush=True)
    prepare()
    on_terminal = sys.stdout.isatty()
    processes = demo_processes(how, free_endpoint(), scale=scale, on_terminal=on_terminal)
    launch(processes, log=out / "demo.log" if on_terminal else None, duration_s=duration)
    show_summary(out)
