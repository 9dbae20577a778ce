"""Watch: running scene -> live table in a terminal, plain lines or JSON."""

import json
import os
import sys
import time
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import zenoh
from rich.console import Console
from rich.live import Live

from comotion_schemas import DEFAULT_SCENE, Event, HypothesisUpdate, ObservationBatch, Status
from comotion_schemas.component import Component, viewer
from comotion_schemas.naming import Names
from comotion_schemas.terminal import keyboard
from comotion_schemas.transport import SessionSettings, client_settings, connect

from .presence import Presence
from .scene_model import SceneModel
from .scene_rows import EventRow
from .subscription import Subscription
from .watch_view import SORTS, WHOLE, Sort, as_json, describe, plain_line, render

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
    message; `ready_file`: written once subscribed; `names`: of hypotheses, by id;
    `all_events`: those of joints too.
    """

    once: bool = False
    json: bool = False
    sort: Sort = "size"
    pose: bool = False
    timeout: float = 5.0
    ready_file: Path | None = None
    names: Names = field(default_factory=dict)
    all_events: bool = False


class _Feed:
    """Fills a scene model from the subscriptions of one scene."""

    def __init__(self, session: zenoh.Session, scene: str, options: WatchOptions) -> None:
        self.model = SceneModel(scene, options.names, all_events=options.all_events)
        self._batches = Subscription(session, ObservationBatch, scene, capacity=8192)
        self._updates = Subscription(session, HypothesisUpdate, scene)
        self._statuses = Subscription(session, Status, scene)
        self._presence = Presence(session, scene)

    def poll(self) -> list[Event]:
        """Process received messages; returns the new events."""
        now, wall_ns = time.monotonic(), time.time_ns()
        for arrived, batch in self._batches.drain():
            self.model.on_batch(batch, arrived, wall_ns - round((now - arrived) * 1e9))
        events = [e for at, update in self._updates.drain() for e in self.model.on_update(update, at)]
        for _, status in self._statuses.drain():
            self.model.on_status(status)
        for role, name, alive in self._presence.drain():
            self.model.on_presence(role, name, alive=alive, now=now)
        return events

    def close(self) -> None:
        """Undeclare everything."""
        for subscription in (self._presence, self._batches, self._updates, self._statuses):
            subscription.close()


def watch(
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    options: WatchOptions | None = None,
) -> None:
    """Show a scene until a signal arrives.

    Parameters
    ----------
    scene, settings
        Name of the scene; how to connect.
    options
        Format and order.

    Raises
    ------
    TimeoutError
        With `once`, if no router answers or no message of the scene arrives.
    ValueError
        If the scene name or an endpoint is not valid.
    """
    settings, options = settings or client_settings(), options or WatchOptions()
    if options.once:
        _once(scene, settings, options)
        return
    with viewer("watch", scene, settings, ready_file=options.ready_file) as component:
        feed = _Feed(component.session, scene, options)
        if options.ready_file is not None:
            component.ready()
        try:
            if options.json or not sys.stdout.isatty():
                _lines(feed, component, options)
            else:
                _screen(feed, component, options)
        finally:
            feed.close()


def _once(scene: str, settings: SessionSettings, options: WatchOptions) -> None:
    with connect(settings, timeout=options.timeout) as session:
        feed = _Feed(session, scene, options)
        try:
            _wait_for_message(feed, settings, options.timeout)
            time.sleep(ONCE_S)
            feed.poll()
        finally:
            feed.close()
    snapshot = feed.model.snapshot(time.monotonic())
    if options.json:
        _emit(json.dumps(as_json(snapshot), indent=2))
        return
    width = POSE_WIDTH if options.pose else PLAIN_WIDTH
    console = Console() if sys.stdout.isatty() else Console(width=width)
    console.print(render(snapshot, console.width, WHOLE, options.sort, keys=False, pose=options.pose))


def _wait_for_message(feed: _Feed, settings: SessionSettings, timeout: float) -> None:
    deadline = time.monotonic() + timeout
    while not feed.model.seen:
        if time.monotonic() > deadline:
            where = ", ".join(settings.connect)
            raise TimeoutError(f"no message of scene {feed.model.scene!r} arrives at {where}")
        time.sleep(0.05)
        feed.poll()


def _lines(feed: _Feed, component: Component, options: WatchOptions) -> None:
    """Print one line per second and one per event, for logs, pipes and scripts."""
    while not component.stop.wait(PLAIN_PERIOD_S):
        events = feed.poll()
        snapshot = feed.model.snapshot(time.monotonic())
        if options.json:
            _emit(json.dumps(as_json(snapshot)))
            continue
        for event in events:
            names = feed.model.names
            row = EventRow(event.stamp_ns, 0.0, event.kind, event.hypothesis, event.others, names)
            words = describe(row)
            _emit(f"{_clock()} {snapshot.scene} {words.plain}")
        _emit(f"{_clock()} {plain_line(snapshot)}")


def _screen(feed: _Feed, component: Component, options: WatchOptions) -> None:
    console = Console()
    sort, pose = options.sort, options.pose
    with keyboard() as read_key, Live(console=console, screen=True, auto_refresh=False) as live:
        while not component.stop.is_set():
            feed.poll()
            width, height = console.size
            snapshot = feed.model.snapshot(time.monotonic())
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
