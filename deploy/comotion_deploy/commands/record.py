"""``comotion record``: records a scene to MCAP files, repairs them and exports them."""

from pathlib import Path
from typing import Annotated

import typer

from .. import options
from ..errors import UserError, missing_extra

EPILOG = """
Examples:

  comotion record

  comotion record take.mcap --scene workcell --duration 60

  comotion record take.mcap --max-size 500 --max-time 600   # take-001.mcap, take-002.mcap, ...

  comotion record --repair take.mcap   # after a crash

  comotion record --export take.mcap --out take-foxglove.mcap   # for Foxglove

To play a recording: comotion source replay take.mcap
"""


def record(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE.mcap]", help="File to write. Default: SCENE-DATE-TIME.mcap.", show_default=False
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", envvar="COMOTION_DURATION", min=0.1, help="Stop after this time, s."),
    ] = None,
    max_size: Annotated[
        float | None,
        typer.Option(
            "--max-size", envvar="COMOTION_MAX_SIZE", min=0.001, help="MiB after which a new file begins."
        ),
    ] = None,
    max_time: Annotated[
        float | None,
        typer.Option(
            "--max-time", envvar="COMOTION_MAX_TIME", min=0.1, help="s after which a new file begins."
        ),
    ] = None,
    reserve: Annotated[
        float,
        typer.Option("--reserve", envvar="COMOTION_RESERVE", min=0, help="MiB that remain free on the disk."),
    ] = 64.0,
    repair: Annotated[
        Path | None,
        typer.Option(
            "--repair",
            metavar="FILE",
            help="Copy all readable messages of a damaged file to a new file, and end.",
        ),
    ] = None,
    export: Annotated[
        Path | None,
        typer.Option("--export", metavar="FILE", help="Convert a recording for Foxglove, and end."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="OUT.mcap", help="Result of --repair or --export."),
    ] = None,
    name: Annotated[
        str,
        typer.Option(
            "--name",
            envvar="COMOTION_RECORDER_NAME",
            callback=options.name_of_certificate,
            help="Name of this recorder. With a certificate: its name.",
        ),
    ] = "recorder",
    scene: options.Scene = "default",
    connect: options.Connect = None,
    listen: options.Listen = None,
    json_: options.Json = False,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    insecure: options.Insecure = False,
    _log_level: options.Log = options.LogLevel.INFO,
    _metrics: options.Metrics = None,
) -> None:
    """Record all messages of a scene to MCAP, byte for byte.

    Data is written to the disk every second: a crash loses at most one second.
    """
    _require_mcap()
    if repair is not None or export is not None:
        if file is not None or (repair is not None and export is not None):
            raise UserError("--repair and --export take one file each and do not record")
        _repair_or_export(repair, export, out, json_=json_)
        return
    if out is not None:
        raise UserError("--out needs --repair or --export")
    from comotion_clients.recording.process import RecordOptions
    from comotion_clients.recording.process import record as run
    from comotion_clients.recording.series import SeriesOptions
    from comotion_schemas import Keys

    result = run(
        RecordOptions(
            series=SeriesOptions(
                path=_target(file, Keys(scene).scene),
                scene=scene,
                max_bytes=None if max_size is None else round(max_size * 2**20),
                max_seconds=max_time,
                reserve_bytes=round(reserve * 2**20),
            ),
            name=name,
            duration=duration,
            ready_file=ready_file,
        ),
        scene,
        options.session_settings(connect, listen, tls, insecure=insecure),
    )
    _print_result(result.as_json(), result.lines(), json_=json_)


def _target(file: Path | None, scene: str) -> Path:
    if file is None:
        from datetime import datetime

        return Path(f"{scene}-{datetime.now().astimezone():%Y%m%d-%H%M%S}.mcap")
    if file.suffix != ".mcap":
        raise UserError(f"{file}: the name of a recording ends in .mcap")
    return file


def _repair_or_export(repair: Path | None, export: Path | None, out: Path | None, *, json_: bool) -> None:
    if repair is not None:
        from comotion_clients.recording.repair import repair as save

        target = out or repair.with_name(f"{repair.stem}-repaired.mcap")
        saved = save(repair, target)
        _print_result(saved.as_json(), saved.lines(target), json_=json_)
    if export is not None:
        try:
            from comotion_clients.recording.export import export as convert
        except ImportError as error:
            raise missing_extra("foxglove", error) from None

        target = out or export.with_name(f"{export.stem}-foxglove.mcap")
        exported = convert(export, target)
        _print_result(exported.as_json(), exported.lines(target), json_=json_)


def _print_result(values: dict[str, object], lines: list[str], *, json_: bool) -> None:
    import json

    print(json.dumps(values, indent=2) if json_ else "\n".join(lines))


def _require_mcap() -> None:
    try:
        import mcap  # noqa: F401
    except ImportError as error:
        raise missing_extra("record", error) from None
