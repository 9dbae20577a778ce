"""Shows a running scene as a live table in a terminal, plain lines or JSON."""

import os
import sys
import threading
import time
from datetime import datetime
from json import dumps
from typing import Unpack

from rich.console import Console
from rich.live import Live

from comotion_schemas import HypothesisUpdate, ObservationBatch, Status
from comotion_schemas.component import Where, viewer
from comotion_schemas.naming import event_words
from comotion_schemas.terminal import keyboard
from comotion_schemas.transport import SessionSettings, client_settings, connect

from .feed import SceneFeed
from .scene_model import SceneModel
from .scene_rows import Snapshot
from .watch_view import SORTS, WHOLE, Sort, as_json, plain_line, render

REFRESH_S = 0.25  # of the screen
PLAIN_PERIOD_S = 1.0  # between two plain lines
POSE_WIDTH, PLAIN_WIDTH = 120, 100  # characters of a table that is not shown on a terminal
ONCE_S = 1.5
"""How long `--once` collects messages, so that rates are known."""


_READ = (ObservationBatch, HypothesisUpdate, Status)


def watch(
    model: SceneModel,
    sort: Sort = "size",
    *,
    once: bool = False,
    json: bool = False,
    pose: bool = False,
    timeout: float = 5.0,
    **where: Unpack[Where],
) -> None:
    """Show a scene until a signal arrives.

    The `model` of the scene is empty. `sort` is the initial order; `pose` adds angular speed and pose of the
    hypotheses; `once` shows one snapshot and ends, and waits for `timeout` s for a first message; `json`
    prints an object per line.

    Raises
    ------
    TimeoutError
        With `once`, if no router answers or no message of the scene arrives.
    """
    if once:
        snapshot = _snapshot(model, where.get("settings") or client_settings(), timeout)
        if json:
            _emit(dumps(as_json(snapshot), indent=2))
            return
        console = Console(width=None if sys.stdout.isatty() else POSE_WIDTH if pose else PLAIN_WIDTH)
        console.print(render(snapshot, console.width, WHOLE, sort, keys=False, pose=pose))
        return
    with viewer("watch", **where) as component, SceneFeed(component.session, component.scene, _READ) as feed:
        if where.get("ready_file") is not None:
            component.ready()
        if json or not sys.stdout.isatty():
            _lines(feed, model, component.stop, json=json)
        else:
            _screen(feed, model, component.stop, sort, pose=pose)


def _snapshot(model: SceneModel, settings: SessionSettings, timeout: float) -> Snapshot:
    """Collect messages for a moment; how the scene is then."""
    with connect(settings, timeout=timeout) as session, SceneFeed(session, model.scene, _READ) as feed:
        deadline = time.monotonic() + timeout
        while not model.seen:
            if time.monotonic() > deadline:
                where = ", ".join(settings.connect)
                raise TimeoutError(f"no message of scene {model.scene!r} arrives at {where}")
            time.sleep(0.05)
            feed.pour(model)
        time.sleep(ONCE_S)
        feed.pour(model)
    return model.snapshot(time.monotonic())


def _lines(feed: SceneFeed, model: SceneModel, stop: threading.Event, *, json: bool) -> None:
    """Print one line per second and one per event, for logs, pipes and scripts."""
    while not stop.wait(PLAIN_PERIOD_S):
        answers, clock = feed.pour(model), datetime.now().astimezone().strftime("%H:%M:%S")
        snapshot = model.snapshot(time.monotonic())
        if json:
            _emit(dumps(as_json(snapshot)))
            continue
        for event in (event for _, events in answers for event in events):
            _emit(f"{clock} {snapshot.scene} {event_words(event, model.names)}")
        _emit(f"{clock} {plain_line(snapshot)}")


def _screen(feed: SceneFeed, model: SceneModel, stop: threading.Event, sort: Sort, *, pose: bool) -> None:
    console = Console()
    with keyboard() as read_key, Live(console=console, screen=True, auto_refresh=False) as live:
        while not stop.is_set():
            feed.pour(model)
            width, height = console.size
            snapshot = model.snapshot(time.monotonic())
            live.update(render(snapshot, width, height, sort, pose=pose), refresh=True)
            match read_key(REFRESH_S):
                case "q":
                    return
                case "s":
                    sort = SORTS[(SORTS.index(sort) + 1) % len(SORTS)]
                case "p":
                    pose = not pose


def _emit(line: str) -> None:
    """Print a line; end the command silently if the reader has closed the pipe (``| head``)."""
    try:
        print(line, flush=True)  # noqa: T201 - the result of the command
    except BrokenPipeError:
        # The rest of the buffer would raise again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise KeyboardInterrupt from None
