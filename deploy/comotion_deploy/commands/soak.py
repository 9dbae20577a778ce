"""``comotion dev soak``: a scene under load and faults, and a report."""

import json
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .. import options

if TYPE_CHECKING:
    from ..soak.run import Runner

EPILOG = """
Examples:

  comotion dev soak

  comotion dev soak --duration 2700 --seed 3 --out /tmp/soak

  comotion dev soak --kills 100      # kill -9 of the service in a row, then SIGSTOP of each process

The status is 0 if nothing was violated, and 1 otherwise.
"""


def soak(
    duration: Annotated[float, typer.Option("--duration", min=20, help="s to run.")] = 180.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the faults.")] = 0,
    kills: Annotated[
        int | None,
        typer.Option(
            "--kills", min=1, help="Instead: kill the service so often in a row, then stop each process."
        ),
    ] = None,
    stopped: Annotated[
        float, typer.Option("--stopped", min=0, help="s for which --kills stops each process; 0: not.")
    ] = 30.0,
    gap: Annotated[
        float,
        typer.Option("--gap", min=0.1, help="s without an update that are allowed."),
    ] = 1.0,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", file_okay=False, help="Where report and logs go.")
    ] = Path("out/soak"),
    json_: options.Json = False,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Run router, service, four sources, recorder and viewer, and make them fail by a seeded schedule.

    Updates must stay on time, ids unique and with their objects, accounts exact, and memory, descriptors,
    threads and logs bounded. Steps of the service's own clock are not tried.
    """
    from comotion_schemas.component import stop_on_signals

    from ..demo import free_endpoint
    from ..soak import report
    from ..soak.run import Runner, clear

    clear(out)
    stop, began = threading.Event(), time.monotonic()

    def say(line: str) -> None:
        if not json_:
            print(f"{time.monotonic() - began:7.1f} s  {line}", flush=True)

    with stop_on_signals(stop), Runner(free_endpoint(), out, stop, say) as runner:
        runner.settle()
        say(f"all bodies have a hypothesis; logs are in {out}")
        _carry_out(runner, duration, seed, kills, stopped, stop)
    found = report.as_json(runner.result, seed, gap)
    (out / "soak.json").write_text(json.dumps(found, indent=2), encoding="utf-8")
    text = report.lines(found)
    (out / "soak.txt").write_text("\n".join(text) + "\n", encoding="utf-8")
    try:
        report.save_plot(out / "soak.png", runner.result)
    except ModuleNotFoundError:
        text.append("no plot: pip install 'comotion[plot]'")
    print(json.dumps(found, indent=2) if json_ else "\n".join(text))
    if found["violations"]:
        raise typer.Exit(1)


def _carry_out(
    runner: "Runner", duration: float, seed: int, kills: int | None, stopped: float, stop: threading.Event
) -> None:
    from ..soak.schedule import draw
    from ..soak.series import kill_in_a_row, stop_each

    if kills is None:
        runner.run(draw(seed, duration), duration)
        return
    kill_in_a_row(runner, kills, stop)
    if stopped:
        stop_each(runner, stopped)
