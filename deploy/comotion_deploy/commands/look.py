"""``comotion watch``, ``comotion view`` and ``comotion status``: a scene in a terminal, a window or once."""

import os
import re
import sys
import threading
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from ..errors import UserError, require_suffix
from ..network import Client, Present
from ..options import Command, Json, argument, option, setting

if TYPE_CHECKING:
    from comotion_clients.feed import Display
    from comotion_clients.viewing.sink import RerunSink
    from comotion_schemas.component import Where
    from comotion_schemas.message_log import MessageLog


class BodyNames(Command):
    """The option of a command that shows hypotheses."""

    name: list[str] | None = setting(
        None,
        "Name of a hypothesis, such as 2=truck; may be repeated.",
        env="COMOTION_NAMES",
        metavar="ID=NAME",
    )

    def names(self) -> dict[int, str]:
        """Return the name of each hypothesis that has one."""
        from comotion_schemas.naming import read_names

        return read_names(self.name or ())


class Watch(BodyNames, Json, Present):
    """Show the current sources, hypotheses, tracks and events of a scene.

    Plain lines if the output is not a terminal; with --json one object per line.
    """

    epilog = """
Examples:
  comotion watch
  comotion watch --scene workcell --sort age
  comotion watch --once --json | jq .service.state
  comotion watch --once --pose
  comotion watch --name 2=truck --name 3=gripper
  comotion watch > scene.log   # one line a second
"""
    log_level = "warning"

    once: bool = setting(False, "Show it once and end.")
    sort: Literal["size", "name", "age"] = setting(
        "size", "By size, by name or id, or by age; the key s changes it."
    )
    pose: bool = setting(False, "Angular speed and pose; the key p changes it.")
    timeout: float = setting(5.0, "How long --once waits for the scene.", min=0.1, metavar="SECONDS")
    all_events: bool = setting(False, "Events of joints too, not of bodies alone.")

    def run(self) -> None:
        """Show it until stopped."""
        from comotion_clients.scene_model import SceneModel
        from comotion_clients.watch import watch

        model = SceneModel(self.scene, self.names(), all_events=self.all_events)
        self.call(watch, model, json=self.json_, **self.where())


_EXIT = {"ok": 0, "degraded": 1, "stalled": 3}


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

        state = self.call(look, settings=self.settings(), expect=self.expect or ())
        if self.json_:
            self.show(state)
        else:
            show(state, Console(width=None if sys.stdout.isatty() else 160))
        raise typer.Exit(_EXIT[state.overall])


class View(BodyNames, Json, Present):
    """Show features, hypotheses, cameras, rates, lags and events of a scene with Rerun or Foxglove.

    In a window where there is a display; with --web, --save or --foxglove elsewhere.
    """

    epilog = """
Examples:
  comotion view   # a window
  comotion view --web --scene workcell   # a page for the browser
  comotion view --web --rate 2   # for a browser without a graphics card
  comotion view --save take.rrd --duration 60   # to look at later: rerun take.rrd
  comotion view --foxglove   # for the Foxglove app: open ws://127.0.0.1:8765
  comotion view take.mcap --regions   # a recording, and the region of each hypothesis in its images
"""
    log_level = "warning"

    recording: Path | None = argument(None, "FILE.mcap", "A recording to show instead of a running scene.")
    web: bool = setting(False, "Serve a page for the browser of this machine.")
    save: Path | None = setting(None, "Write a new file for the Rerun viewer.", metavar="FILE.rrd")
    foxglove: bool = setting(False, "Serve the scene to the Foxglove app.")
    foxglove_port: int = setting(8765, "Its port; 0: any.", min=0, max=65535)
    port: int = setting(9090, "Port of the page.", env="COMOTION_WEB_PORT", min=1, max=65535)
    data_port: int = setting(9876, "Port of the page's data.", env="COMOTION_WEB_DATA_PORT", min=1, max=65535)
    browser: bool = setting(True, "Open the page.")
    memory: str = setting(
        "1GB",
        "Memory for the history, e.g. 500MB, 2GB or 25%; the oldest data is dropped first.",
        env="COMOTION_VIEW_MEMORY",
    )
    rate: float | None = setting(
        None,
        "Most updates, and images of each camera, per second. Fewer for a slow browser.",
        env="COMOTION_VIEW_RATE",
        min=0.1,
        max=1000,
        metavar="HZ",
    )
    regions: bool = setting(False, "Colour the region of each hypothesis in images.")
    duration: float | None = setting(None, "Stop after this time.", min=0.1, metavar="SECONDS")

    def run(self) -> None:
        """Show it until stopped."""
        from comotion_schemas import Keys

        # Checks the name and the endpoints before anything opens.
        Keys(self.scene)
        where = self.where() if self.recording is None else {}
        if self.foxglove:
            from comotion_clients.foxglove.scene import FoxgloveDisplay

            with self._log() as log, FoxgloveDisplay(self.foxglove_port, self.names()) as display:
                print(f"open {display.url} in Foxglove", file=sys.stderr, flush=True)
                self._show(display, log, where, in_time=True)
            return
        import rerun  # noqa: F401 - before a window opens
        import rerun_cli  # noqa: F401

        destination = self._destination()
        from comotion_clients.viewing.picture import ScenePicture
        from comotion_schemas.component import stop_on_signals

        stop = threading.Event()
        with self._log() as log, destination as sink:
            if sink.url is not None:
                print(f"look at {sink.url}", file=sys.stderr, flush=True)
            scene = self.scene if log is None else log.scene
            names = self.names()
            picture = ScenePicture(scene, self.rate, dense=self.regions, names=names, sink=sink)
            with nullcontext() if log is None else stop_on_signals(stop):
                self._show(picture, log, where)
                if log is not None and (sink.window or sink.web_port is not None):
                    sink.wait(stop, self.duration)

    def _log(self) -> "AbstractContextManager[MessageLog | None]":
        """The recording to show, if it is no running scene."""
        if self.recording is None:
            return nullcontext()
        from comotion_schemas.message_log import MessageLog

        return MessageLog(self.recording)

    def _show(
        self, display: "Display", log: "MessageLog | None", where: "Where", *, in_time: bool = False
    ) -> None:
        """Give a display the running scene, or the recording."""
        from comotion_clients.feed import follow, play
        from comotion_schemas.text import counted

        if log is None:
            viewed = follow(display, self.duration, **where)
            if self.json_:
                self.show(viewed)
            else:
                print(viewed.line(), file=sys.stderr)
            return
        shown = play(display, log.decoded(), in_time=in_time)
        if not shown and not self.foxglove:  # which shows images without
            raise UserError(f"{self.recording}: it holds no hypotheses; was the service recorded?")
        print(f"{self.recording}: {counted(shown, 'update')}", file=sys.stderr)

    def _destination(self) -> "RerunSink":
        from comotion_clients.viewing.sink import RerunSink

        if re.fullmatch(r"\d+(\.\d+)?(%|[kMGT]i?B)", self.memory) is None:
            raise UserError(f"--memory {self.memory}: expected something like 500MB, 2GB or 25%")
        if self.recording is not None and self.recording.suffix == ".rrd":
            raise UserError(
                f"{self.recording} is a file of Rerun's own; look at it with: rerun {self.recording}"
            )
        if self.save is not None:
            require_suffix(self.save, "a file for Rerun", ".rrd")
        window = not self.web and self.save is None
        if window and not _has_display():
            raise UserError("there is no display for a window: use --web (browser) or --save FILE.rrd")
        web_port, opened = self.port if self.web else None, self.browser and _has_display()
        return self.call(RerunSink, window=window, web_port=web_port, open_browser=opened, file=self.save)


def _has_display() -> bool:
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
