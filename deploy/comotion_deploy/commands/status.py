"""``comotion status``: one look at a scene, for people and scripts."""

from enum import StrEnum
from typing import Annotated

import typer

from .. import options

EPILOG = """
Examples:

  comotion status

  comotion status --scene cell --connect tls/10.0.0.1:7447 --tls pki/laptop

  comotion status --wait ok --timeout 60 --expect klt-left --expect klt-right   # in a script

  comotion status --json | jq '.components[] | {name, host, clock_s}'

Exit status: 0 ok; 1 degraded; 3 stalled, or no service; 2 no router answers, or a wrong option.
"""
_EXIT = {"ok": 0, "degraded": 1, "stalled": 3}


class WaitChoice(StrEnum):
    """States to wait for."""

    OK = "ok"


def status(
    wait: Annotated[
        WaitChoice | None, typer.Option("--wait", help="Look again until the scene is in this state.")
    ] = None,
    timeout: Annotated[
        float, typer.Option("--timeout", envvar="COMOTION_TIMEOUT", min=0.1, help="Longest wait, s.")
    ] = 10.0,
    expect: Annotated[
        list[str] | None, typer.Option("--expect", help="A component that must be there; may be repeated.")
    ] = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Show services, sources, recorders, viewers and routers of a scene, and what to look at.

    The clock of a component is how far it is ahead of the service's.
    """
    import json
    import sys

    from rich.console import Console

    from comotion_clients.status import StatusOptions
    from comotion_clients.status import status as look
    from comotion_clients.status_view import show

    how = StatusOptions(wait="ok" if wait else None, timeout=timeout, expect=tuple(expect or ()))
    found = look(scene, options.session_settings(connect, tls=tls), how)
    if json_:
        print(json.dumps(found.as_json(), indent=2))
    else:
        show(found, Console(width=None if sys.stdout.isatty() else 160))
    raise typer.Exit(_EXIT[found.overall])
