"""``comotion status``: one look at a scene, for people and scripts."""

import sys
from dataclasses import dataclass
from typing import Literal

import typer

from ..options import Client, Json, option, setting

_EXIT = {"ok": 0, "degraded": 1, "stalled": 3}


@dataclass(kw_only=True)
class Status(Json, Client):
    """Show services, sources, recorders, viewers and routers of a scene, and what to look at.

    The clock of a component is how far it is ahead of the service's.
    """

    epilog = """
Examples:
  comotion status
  comotion status --scene cell --connect tls/10.0.0.1:7447 --tls pki/laptop
  comotion status --wait ok --timeout 60 --expect klt-left --expect klt-right   # in a script
  comotion status --json | jq '.components[] | {name, host, clock_s}'

Exit status: 0 ok; 1 degraded; 3 stalled, or no service; 2 no router answers, or a wrong option.
"""
    log_level = "warning"

    wait: Literal["ok"] | None = option(None, "Look again until the scene is in this state.")
    timeout: float = setting(10.0, "Longest wait.", min=0.1, metavar="SECONDS")
    expect: list[str] | None = option(None, "A component that must be there; may be repeated.")

    def run(self) -> None:
        """Show the status, and end with the exit status that says it."""
        from rich.console import Console

        from comotion_clients.status import show
        from comotion_clients.status import status as look

        state = look(
            self.scene, self.settings(), wait=self.wait, timeout=self.timeout, expect=self.expect or ()
        )
        if self.json_:
            self.show(state)
        else:
            show(state, Console(width=None if sys.stdout.isatty() else 160))
        raise typer.Exit(_EXIT[state.overall])
