"""``comotion view``: shows a scene in a window, a browser or a file."""

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .. import options
from ..errors import UserError, missing_extra, require_dense

if TYPE_CHECKING:
    from comotion_clients.viewing.process import Viewed, ViewOptions
    from comotion_clients.viewing.sink import Destination, RerunSink
    from comotion_schemas.transport import SessionSettings

EPILOG = """
Examples:

  comotion view   # a window

  comotion view --web --scene workcell   # a page for the browser

  comotion view --web --rate 2   # for a browser without a graphics card

  comotion view --save take.rrd --duration 60   # to look at later: rerun take.rrd

  comotion view --foxglove   # for the Foxglove app: open ws://127.0.0.1:8765

  comotion view take.mcap --regions   # a recording, and the region of each hypothesis in its images
"""


def view(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE.mcap]", help="A recording to show instead of a running scene.", show_default=False
        ),
    ] = None,
    web: Annotated[
        bool,
        typer.Option("--web", envvar="COMOTION_WEB", help="Serve a page for the browser of this machine."),
    ] = False,
    save: Annotated[
        Path | None,
        typer.Option(
            "--save",
            envvar="COMOTION_SAVE",
            metavar="FILE.rrd",
            help="Write a new file for the Rerun viewer.",
        ),
    ] = None,
    foxglove: Annotated[
        bool,
        typer.Option("--foxglove", envvar="COMOTION_FOXGLOVE", help="Serve the scene to the Foxglove app."),
    ] = False,
    foxglove_port: Annotated[
        int,
        typer.Option(
            "--foxglove-port", envvar="COMOTION_FOXGLOVE_PORT", min=0, max=65535, help="Its port; 0: any."
        ),
    ] = 8765,
    port: Annotated[
        int, typer.Option("--port", envvar="COMOTION_WEB_PORT", min=1, max=65535, help="Port of the page.")
    ] = 9090,
    data_port: Annotated[
        int,
        typer.Option(
            "--data-port", envvar="COMOTION_WEB_DATA_PORT", min=1, max=65535, help="Port of the page's data."
        ),
    ] = 9876,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", envvar="COMOTION_BROWSER", help="Open the page.")
    ] = True,
    memory: Annotated[
        str,
        typer.Option(
            "--memory",
            envvar="COMOTION_VIEW_MEMORY",
            help="Memory for the history, e.g. 500MB, 2GB or 25%; the oldest data is dropped first.",
        ),
    ] = "1GB",
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            envvar="COMOTION_VIEW_RATE",
            min=0.1,
            max=1000,
            metavar="HZ",
            help="Most updates, and images of each camera, per second. Fewer for a slow browser.",
        ),
    ] = None,
    regions: Annotated[
        bool,
        typer.Option(
            "--regions",
            envvar="COMOTION_REGIONS",
            help="Colour the region of each hypothesis in images. Needs scikit-image.",
        ),
    ] = False,
    duration: Annotated[
        float | None,
        typer.Option("--duration", envvar="COMOTION_DURATION", min=0.1, help="Stop after this time, s."),
    ] = None,
    names: options.BodyNames = None,
    scene: options.Scene = "default",
    connect: options.Connect = None,
    json_: options.Json = False,
    ready_file: options.ReadyFile = None,
    _config: options.ConfigFile = None,
    tls: options.Tls = None,
    _log_level: options.Log = options.LogLevel.WARNING,
) -> None:
    """Show features, hypotheses, cameras, rates, lags and events of a scene with Rerun or Foxglove.

    In a window where there is a display; with --web, --save or --foxglove elsewhere.
    """
    from comotion_schemas.naming import read_names

    called = read_names(names or ())
    if foxglove:
        _serve_foxglove(
            recording,
            foxglove_port,
            called,
            scene,
            options.session_settings(connect, tls=tls),
            duration,
            ready_file,
            json_=json_,
        )
        return
    _require_rerun()
    if regions:
        require_dense()
    from comotion_clients.viewing.sink import Destination

    if re.fullmatch(r"\d+(\.\d+)?(%|[kMGT]i?B)", memory) is None:
        raise UserError(f"--memory {memory}: expected something like 500MB, 2GB or 25%")
    if recording is not None and recording.suffix == ".rrd":
        raise UserError(f"{recording} is a file of Rerun's own; look at it with: rerun {recording}")
    if save is not None and save.suffix != ".rrd":
        raise UserError(f"{save}: the name of a file for Rerun ends in .rrd")
    window = not web and save is None
    if window:
        _require_display()
    where = Destination(
        window=window,
        web_port=port if web else None,
        data_port=data_port,
        open_browser=browser and _has_display(),
        file=save,
        memory=memory,
    )
    if recording is not None:
        _show_recording(recording, where, duration, dense=regions, names=called)
    else:
        from comotion_clients.viewing.process import ViewOptions

        how = ViewOptions(duration=duration, rate=rate, ready_file=ready_file, dense=regions, names=called)
        _show_scene(where, scene, options.session_settings(connect, tls=tls), how, json_=json_)


def _serve_foxglove(
    recording: Path | None,
    port: int,
    names: dict[int, str],
    scene: str,
    settings: "SessionSettings",
    duration: float | None,
    ready_file: Path | None,
    *,
    json_: bool,
) -> None:
    try:
        from comotion_clients.foxglove.server import FoxgloveDisplay
    except ImportError as error:
        raise missing_extra("foxglove", error) from None
    from comotion_clients.viewing.process import ViewOptions, follow
    from comotion_schemas import Keys

    Keys(scene)  # checks the name before the server starts
    with FoxgloveDisplay(port, names) as display:
        print(f"open {display.url} in Foxglove", file=sys.stderr, flush=True)
        if recording is None:
            how = ViewOptions(duration=duration, ready_file=ready_file)
            _print_viewed(follow(display, scene, settings, how), json_=json_)
            return
        try:
            from comotion_clients.recording.reading import Reading
        except ImportError as error:
            raise missing_extra("record", error) from None
        with Reading(recording) as reading:
            print(f"{recording}: {display.play(reading.messages())} updates", file=sys.stderr)


def _print_viewed(result: "Viewed", *, json_: bool) -> None:
    import json
    from dataclasses import asdict

    if json_:
        print(json.dumps(asdict(result), indent=2))
    else:
        print(result.line(), file=sys.stderr)


def _show_scene(
    where: "Destination",
    scene: str,
    settings: "SessionSettings",
    how: "ViewOptions",
    *,
    json_: bool,
) -> None:
    from comotion_clients.viewing.process import view as run
    from comotion_clients.viewing.sink import RerunSink
    from comotion_schemas import Keys

    Keys(scene)  # checks the name before a window opens
    with RerunSink(where) as sink:
        _print_address(sink)
        result = run(sink, scene, settings, how)
    _print_viewed(result, json_=json_)


def _show_recording(
    recording: Path, where: "Destination", duration: float | None, *, dense: bool, names: dict[int, str]
) -> None:
    import threading

    try:
        from comotion_clients.recording.reading import Reading
    except ImportError as error:
        raise missing_extra("record", error) from None
    from comotion_clients.viewing.process import view_messages
    from comotion_clients.viewing.sink import RerunSink
    from comotion_schemas.component import stop_on_signals

    stop = threading.Event()
    with Reading(recording) as reading, RerunSink(where) as sink, stop_on_signals(stop):
        _print_address(sink)
        shown = view_messages(reading.messages(), reading.scene(), sink, dense=dense, names=names)
        if not shown:
            raise UserError(f"{recording}: it holds no hypotheses; was the service recorded?")
        print(f"{recording}: {shown} updates", file=sys.stderr)
        if where.window or where.web_port is not None:
            sink.wait(stop, duration)


def _print_address(sink: "RerunSink") -> None:
    if sink.url is not None:
        print(f"look at {sink.url}", file=sys.stderr, flush=True)


def _has_display() -> bool:
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _require_display() -> None:
    if not _has_display():
        raise UserError("there is no display for a window: use --web (browser) or --save FILE.rrd")


def _require_rerun() -> None:
    try:
        import rerun  # noqa: F401
        import rerun_cli  # noqa: F401
    except ImportError as error:
        raise missing_extra("view", error) from None
