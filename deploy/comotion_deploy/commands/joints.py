"""``comotion joints``: how the bodies of a scene are connected, as a table, JSON or URDF."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .. import options
from ..errors import UserError, missing_extra
from ..fusion_options import fusion_config

if TYPE_CHECKING:
    from comotion_schemas import HypothesisUpdate
    from comotion_schemas.transport import SessionSettings

EPILOG = """
Examples:

  comotion joints   # of a running scene

  comotion joints --name 1=cabinet --name 2=door   # "door turns on cabinet, 0 to 65°"

  comotion joints take.mcap --urdf cabinet.urdf

  comotion joints sim:fig4_4 --duration 6 --json
"""

_OFFLINE_ONLY = ("method", "assignments", "duration")
_LIVE_ONLY = ("scene", "connect", "tls", "timeout")


def joints(
    ctx: typer.Context,
    file: Annotated[
        str | None,
        typer.Argument(
            metavar="[FILE]",
            help="A recording (.c3d, .npz, .mcap) or a simulated scene (sim:NAME). "
            "Without: the running scene.",
            show_default=False,
        ),
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option("--urdf", envvar="COMOTION_URDF", metavar="FILE", help="Write a URDF file."),
    ] = None,
    space: Annotated[
        str | None,
        typer.Option("--space", envvar="COMOTION_SPACE", help="Space of the URDF, where there are several."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            "--duration", envvar="COMOTION_DURATION", min=0.1, help="s of the file. Default: to the end."
        ),
    ] = None,
    timeout: Annotated[
        float,
        typer.Option("--timeout", envvar="COMOTION_TIMEOUT", min=0.1, help="s to wait for an update."),
    ] = 5.0,
    names: options.BodyNames = None,
    method: options.Method = None,
    assignments: options.Assignments = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    tls: options.Tls = None,
    json_: options.Json = False,
    _config: options.ConfigFile = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Say how the bodies of a scene are connected, as of the last update: hinges, slides, fixed ones.

    The URDF has a link for each hypothesis with a pose, as a box of its extent, and its joints with
    the ranges seen. Position 0 is that of the update; what has no joint floats. Masses are made up.
    """
    if file is None:
        options.reject_flags(ctx, _OFFLINE_ONLY, "is only for a FILE")
        update = _live(scene, options.session_settings(connect, tls=tls), timeout)
    else:
        options.reject_flags(ctx, _LIVE_ONLY, "is only for a running scene, without FILE")
        from comotion_experiments.inputs import find_inputs
        from comotion_experiments.offline import last_update

        config = fusion_config(ctx, method, assignments)
        try:
            (one,) = find_inputs([file])
        except ImportError as error:
            raise missing_extra("record", error) from None
        update = last_update(one.open(), config, duration)
    _print(update, names or [], json_=json_)
    if urdf is not None:
        from comotion_clients.urdf import to_urdf

        urdf.write_text(to_urdf(update, space), encoding="utf-8")
        if not json_:
            print(f"urdf: {urdf}")


def _live(scene: str, settings: "SessionSettings", timeout: float) -> "HypothesisUpdate":
    from comotion_clients.subscribe import subscribe

    with subscribe(scene, settings.connect, timeout=timeout, tls=settings.tls) as updates:
        try:
            return next(updates)
        except TimeoutError:
            raise UserError(f"no update of scene {scene} within {timeout:g} s") from None


def _print(update: "HypothesisUpdate", names: list[str], *, json_: bool) -> None:
    from comotion_clients.joint_rows import as_json, table
    from comotion_schemas.naming import read_names

    if json_:
        import json

        print(json.dumps(as_json(update), indent=2))
        return
    from rich.console import Console

    Console(width=None if sys.stdout.isatty() else 120).print(table(update.joints, read_names(names)))
