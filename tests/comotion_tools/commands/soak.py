"""``comotion dev soak``: a scene under load and faults, and a report."""

import json
import threading
import time
from pathlib import Path

import typer

from comotion_deploy.options import Json, Logged, option


class Soak(Json, Logged):
    """Run router, service, four sources, recorder and viewer, and make them fail by a seeded schedule.

    Updates must stay on time, ids unique and with their objects, accounts exact, and memory, descriptors,
    threads and logs bounded. Steps of the service's own clock are not tried.
    """

    epilog = """
Examples:
  comotion dev soak
  comotion dev soak --duration 2700 --seed 3 --out /tmp/soak
  comotion dev soak --fault kill --target service   # kill -9 of the service, again and again
  comotion dev soak --fault hostile --target spaces # one source with 2000 features in 100 spaces
  comotion dev soak --fault none --features 111     # 1000 features in metres, latency and load

The status is 0 if nothing was violated, and 1 otherwise.
"""
    log_level = "warning"

    duration: float = option(180.0, "s to run.", min=20)
    seed: int = option(0, "Seed of the faults.", min=0)
    fault: str = option("", "Faults of one kind alone, e.g. kill, stop or hostile; or none.", metavar="KIND")
    target: str = option("", "Faults of one process, e.g. service, or one attack alone.", metavar="NAME")
    gap: float = option(1.0, "s without an update that are allowed.", min=0.1)
    features: int | None = option(None, "Of each body in each source. Default: 4 to 15.", min=3, max=999)
    out: Path = option(Path("out/soak"), "Where report and logs go.", metavar="DIR", file_okay=False)

    def run(self) -> None:
        """Run it; exit status 1 if something was violated."""
        from comotion_deploy.demo import free_endpoint
        from comotion_schemas.component import stop_on_signals
        from comotion_tools.soak import report
        from comotion_tools.soak.run import Runner, clear
        from comotion_tools.soak.schedule import draw

        faults = draw(self.seed, self.duration, self.fault, self.target)
        clear(self.out)
        stop, began = threading.Event(), time.monotonic()

        def say(line: str) -> None:
            if not self.json_:
                print(f"{time.monotonic() - began:7.1f} s  {line}", flush=True)

        with (
            stop_on_signals(stop),
            Runner(free_endpoint(), self.out, stop, say, features=self.features) as runner,
        ):
            runner.settle()
            say(f"all bodies have a hypothesis; logs are in {self.out}")
            runner.run(faults, self.duration)
        values = report.as_json(runner.result, self.seed, self.gap)
        (self.out / "soak.json").write_text(json.dumps(values, indent=2), encoding="utf-8")
        self.show(values, *report.lines(values))
        if values["violations"]:
            raise typer.Exit(1)
