"""Shows a running scene as a live table in a terminal, plain lines or JSON."""

import json
import os
import sys
import time
from dataclasses import dataclass, field
from datetime import datetime
from typing import Unpack

from rich.console import Console
from rich.live import Live

from comotion_schemas import DEFAULT_SCENE, HypothesisUpdate, ObservationBatch, Status
from comotion_schemas.component import Component, Where, viewer
from comotion_schemas.naming import Names, event_words
from comotion_schemas.terminal import keyboard
from comotion_schemas.transport import SessionSettings, client_settings, connect

from .feed import SceneFeed
from .scene_model import SceneModel
from .watch_view import SORTS, WHOLE, Sort, as_json, plain_line, render

REFRESH_S = 0.25  # of the screen
PLAIN_PERIOD_S = 1.0  # between two plain lines
POSE_WIDTH, PLAIN_WIDTH = 120, 100  # characters of a table that is not shown on a terminal
ONCE_S = 1.5
"""How long `--once` collects messages, so that rates are known."""


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Options of watch.

    `once`: show one snapshot and end; `json`: one JSON object per line; `sort`: initial order;
    `pose`: angular speed and pose of the hypotheses; `timeout`: seconds that `once` waits for a first
    message; `names`: of hypotheses, by id; `all_events`: those of joints too.
    """

    once: bool = False
    json: bool = False
    sort: Sort = "size"
    pose: bool = False
    timeout: float = 5.0
    names: Names = field(default_factory=dict)
    all_events: bool = False


_READ = (ObservationBatch, HypothesisUpdate, Status)


def watch(options: WatchOptions | None = None, **where: Unpack[Where]) -> None:
    """Show a scene until a signal arrives.

    Parameters
    ----------
    options
        Format and order.
    where
        Name of the scene, how to connect, and the ready file.

    Raises
    ------
    TimeoutError
        With `once`, if no router answers or no message of the scene arrives.
    ValueError
        If the scene name or an endpoint is not valid.
    """
    options, scene = options or WatchOptions(), where.get("scene", DEFAULT_SCENE)
    model = SceneModel(scene, options.names, all_events=options.all_events)
    if options.once:
        _once(model, where.get("settings") or client_settings(), options)
        return
    with (
        viewer("watch", **where) as component,
        SceneFeed(component.session, component.scene, _READ) as feed,
    ):
        if where.get("ready_file") is not None:
            component.ready()
        if options.json or not sys.stdout.isatty():
            _lines(feed, model, component, options)
        else:
            _screen(feed, model, component, options)


def _once(model: SceneModel, settings: SessionSettings, options: WatchOptions) -> None:
    """Collect messages for a moment, and show how the scene is."""
    with (
        connect(settings, timeout=options.timeout) as session,
        SceneFeed(session, model.scene, _READ) as feed,
    ):
        deadline = time.monotonic() + options.timeout
        while not model.seen:
            if time.monotonic() > deadline:
                where = ", ".join(settings.connect)
                raise TimeoutError(f"no message of scene {model.scene!r} arrives at {where}")
            time.sleep(0.05)
            feed.pour(model)
        time.sleep(ONCE_S)
        feed.pour(model)
    snapshot = model.snapshot(time.monotonic())
    if options.json:
        _emit(json.dumps(as_json(snapshot), indent=2))
        return
    console = Console(width=None if sys.stdout.isatty() else POSE_WIDTH if options.pose else PLAIN_WIDTH)
    console.print(render(snapshot, console.width, WHOLE, options.sort, keys=False, pose=options.pose))


def _lines(feed: SceneFeed, model: SceneModel, component: Component, options: WatchOptions) -> None:
    """Print one line per second and one per event, for logs, pipes and scripts."""
    while not component.stop.wait(PLAIN_PERIOD_S):
        answers = feed.pour(model)
        snapshot = model.snapshot(time.monotonic())
        if options.json:
            _emit(json.dumps(as_json(snapshot)))
            continue
        for event in (event for _, events in answers for event in events):
            _emit(f"{_clock()} {snapshot.scene} {event_words(event, model.names)}")
        _emit(f"{_clock()} {plain_line(snapshot)}")


def _screen(feed: SceneFeed, model: SceneModel, component: Component, options: WatchOptions) -> None:
    console = Console()
    sort, pose = options.sort, options.pose
    with keyboard() as read_key, Live(console=console, screen=True, auto_refresh=False) as live:
        while not component.stop.is_set():
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


def _clock() -> str:
    return datetime.now().astimezone().strftime("%H:%M:%S")


def _emit(line: str) -> None:
    """Print a line; end the command silently if the reader has closed the pipe (``| head``)."""
    try:
        print(line, flush=True)  # noqa: T201 - the result of the command
    except BrokenPipeError:
        # The rest of the buffer would raise again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise KeyboardInterrupt from None
