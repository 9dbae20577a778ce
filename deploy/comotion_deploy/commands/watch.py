"""``comotion watch``: a live table of one scene."""

from enum import StrEnum
from typing import Annotated

import typer

from .. import options

EPILOG = """
Examples:

  comotion watch

  comotion watch --scene workcell --sort age

  comotion watch --once --json | jq .service.state

  comotion watch --once --pose

  comotion watch --name 2=truck --name 3=gripper

  comotion watch > scene.log   # one line a second
"""


class SortChoice(StrEnum):
    """Order of sources and hypotheses."""

    SIZE = "size"
    NAME = "name"
    AGE = "age"


def watch(
    once: Annotated[
        bool, typer.Option("--once", envvar="COMOTION_ONCE", help="Show it once and end.")
    ] = False,
    sort: Annotated[
        SortChoice,
        typer.Option(
            "--sort", envvar="COMOTION_SORT", help="By size, by name or id, or by age; the key s changes it."
        ),
    ] = SortChoice.SIZE,
    pose: Annotated[
        bool,
        typer.Option("--pose", envvar="COMOTION_POSE", help="Angular speed and pose; the key p changes it."),
    ] = False,
    timeout: Annotated[
        float,
        typer.Option(
            "--timeout", envvar="COMOTION_TIMEOUT", min=0.1, help="s that --once waits for the scene."
        ),
    ] = 5.0,
    names: options.BodyNames = None,
    all_events: Annotated[
        bool,
        typer.Option(
            "--all-events", envvar="COMOTION_ALL_EVENTS", help="Events of joints too, not of bodies alone."
        ),
    ] = False,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    json_: options.Json = False,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Show the current sources, hypotheses, tracks and events of a scene.

    Plain lines if the output is not a terminal; with --json one object per line.
    """
    from comotion_clients.watch import WatchOptions, watch
    from comotion_schemas.naming import read_names

    how = WatchOptions(
        once=once,
        json=json_,
        sort=sort.value,
        pose=pose,
        timeout=timeout,
        ready_file=ready_file,
        names=read_names(names or ()),
        all_events=all_events,
    )
    watch(scene, options.session_settings(connect, tls=tls), how)
