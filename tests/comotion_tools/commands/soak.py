"""``comotion dev soak``: a scene under load and faults, and a report."""

from dataclasses import dataclass
from pathlib import Path

import typer

from comotion_deploy.options import Json, Logged, option


@dataclass(kw_only=True)
class Soak(Json, Logged):
    """Run router, service, four sources, recorder and viewer, and make them fail by a seeded schedule.

    Updates must stay on time, ids unique and with their objects, accounts exact, and memory, descriptors,
    threads and logs bounded. Steps of the service's own clock are not tried.
    """

    epilog = """
Examples:
  comotion dev soak
  comotion dev soak --duration 2700 --seed 3 --out /tmp/soak
  comotion dev soak --kills 100      # kill -9 of the service in a row, then SIGSTOP of each process

The status is 0 if nothing was violated, and 1 otherwise.
"""
    log_level = "warning"

    duration: float = option(180.0, "s to run.", min=20)
    seed: int = option(0, "Seed of the faults.", min=0)
    kills: int | None = option(
        None, "Instead: kill the service so often in a row, then stop each process.", min=1
    )
    stopped: float = option(30.0, "s for which --kills stops each process; 0: not.", min=0)
    gap: float = option(1.0, "s without an update that are allowed.", min=0.1)
    out: Path = option(Path("out/soak"), "Where report and logs go.", metavar="DIR", file_okay=False)

    def run(self) -> None:
        """Run it; exit status 1 if something was violated."""
        from comotion_tools.soak.command import soak

        if soak(self):
            raise typer.Exit(1)
