"""``comotion source replay``: publishes a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .. import options
from ..errors import UserError, missing_extra
from . import source_options

if TYPE_CHECKING:
    from comotion_schemas.transport import SessionSettings

EPILOG = """
Examples:

  comotion source replay tennis_serve.c3d

  comotion source replay take.npz --loop --speed 2

  comotion source replay take.npz --split 3   # three sources, at 1, 1/2 and 1/3 of the rate

  comotion source replay take.npz --rate 50,25,10 --split 3

  comotion source replay take.npz --rate 30 --part 2/3 --start-at aligned --loop   # one of three processes

  comotion source replay take.npz --stamps original   # for: comotion serve --clock event

  comotion source replay scene.mcap --start 10 --end 40   # all sources of a recording of comotion record
"""
_NOT_FOR_MCAP = ("rate", "split", "part", "name")
_MCAP_ONLY = ("start", "end")


def replay(
    ctx: typer.Context,
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recording: .c3d or .npz; .mcap of a whole scene.")
    ],
    speed: Annotated[
        float, typer.Option("--speed", envvar="COMOTION_SPEED", help="Recorded seconds per second.")
    ] = 1.0,
    loop: source_options.Loop = False,
    rate: Annotated[
        str | None,
        typer.Option(
            "--rate",
            envvar="COMOTION_RATE",
            metavar="HZ[,HZ...]",
            help="Reduce to this rate by dropping frames, for all sources or for each. Default: that of the "
            "recording; 1/K of it for the K-th of several sources.",
        ),
    ] = None,
    start: Annotated[
        float, typer.Option("--start", envvar="COMOTION_START", min=0, help="Start of the range, s (.mcap).")
    ] = 0.0,
    end: Annotated[
        float | None, typer.Option("--end", envvar="COMOTION_END", min=0, help="End of the range, s (.mcap).")
    ] = None,
    split: Annotated[
        int,
        typer.Option(
            "--split",
            envvar="COMOTION_REPLAY_SPLIT",
            min=1,
            max=64,
            help="Divide the markers among this number of sources, all in this process.",
        ),
    ] = 1,
    part: source_options.Part = None,
    stamps: Annotated[
        source_options.StampChoice,
        typer.Option(
            "--stamps",
            envvar="COMOTION_STAMPS",
            help="Stamp with the wall clock, or with the time of the recording from 0 on "
            "(then serve with --clock event).",
        ),
    ] = source_options.StampChoice.NOW,
    start_at: source_options.StartAt = "now",
    duration: source_options.Duration = None,
    name: source_options.Names = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    listen: options.Listen = None,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    insecure: options.Insecure = False,
    _log_level: options.Log = options.LogLevel.INFO,
    _metrics: options.Metrics = None,
) -> None:
    """Publish a recording, with truth if it has labels, as one source or several.

    A recorded scene (.mcap) is published as its recorded sources, with
    --stamps original byte for byte. The space bar pauses it.
    """
    if file.suffix.lower() == ".mcap":
        options.reject_flags(ctx, _NOT_FOR_MCAP, "is not for a recorded scene (.mcap)")
        _replay_scene(
            file,
            {"speed": speed, "loop": loop, "start": start, "end": end, "duration": duration},
            stamps,
            start_at,
            (scene, options.session_settings(connect, listen, tls, insecure=insecure), ready_file),
        )
        return
    options.reject_flags(ctx, _MCAP_ONLY, "is only for a recorded scene (.mcap)")
    from comotion_sources import parts, player
    from comotion_sources import replay as process
    from comotion_sources.recordings import read_recording

    chosen = parts.parse_part(part) if part else None
    if chosen is not None and split not in {1, chosen.count}:
        raise UserError(f"--part {part} and --split {split} do not agree")
    when = player.parse_start(start_at)
    rates = parts.parse_rates(rate) if rate else None
    recording = read_recording(file)
    streams = process.choose_streams(
        recording,
        split=split,
        part=chosen,
        rates=rates,
        name=name,
        speed=speed,
        stamps=stamps.value,
    )
    process.run(
        recording,
        streams,
        process.schedule(speed=speed, stamps=stamps.value, loop=loop, duration=duration, start_at=when),
        scene=scene,
        settings=options.session_settings(connect, listen, tls, insecure=insecure),
        ready_file=ready_file,
    )


def _replay_scene(
    file: Path,
    when: "dict[str, Any]",
    stamps: source_options.StampChoice,
    start_at: str,
    where: "tuple[str, SessionSettings, Path | None]",
) -> None:
    try:
        from comotion_sources import message_replay, player
        from comotion_sources.message_tape import MessageSchedule
    except ImportError as error:
        raise missing_extra("record", error) from None
    instant = player.parse_start(start_at)
    if instant == "aligned":
        raise UserError("--start-at aligned is not for a recorded scene (.mcap)")
    schedule = MessageSchedule(
        **when, stamps=stamps.value, start_at=None if instant == "now" else float(instant)
    )
    scene, settings, ready_file = where
    message_replay.run(file, schedule, scene=scene, settings=settings, ready_file=ready_file)
