"""The viewer as a process: subscriptions on one side, a sink for shapes on the other.

It reads from bounded rings and inboxes that drop the oldest, so that it delays nobody however slow
the display is.
"""

import logging
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import zenoh

from comotion_schemas import (
    DEFAULT_SCENE,
    HypothesisUpdate,
    Message,
    ObservationBatch,
    Preview,
    Status,
    TruthBatch,
)
from comotion_schemas.component import Component, StatusFields, new_session_id
from comotion_schemas.transport import SessionSettings

from ..presence import Presence
from ..subscription import Subscription
from .picture import ScenePicture
from .shapes import Layout, Moment

TICK_S = 0.02
UPDATES_KEPT = 4
"""Updates that may wait when the display is slow; older ones are not worth showing any more."""
_AGES_KEPT = 36_000
_log = logging.getLogger(__name__)


class Sink(Protocol):
    """Where moments are shown."""

    @property
    def closed(self) -> bool:
        """Whether nobody looks any more."""

    def arrange(self, layout: Layout) -> None:
        """Arrange the views."""

    def show(self, moments: Iterable[Moment]) -> None:
        """Show moments; returns when they are handed over."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """How long to view, in s (None: until stopped), and the file to write once it shows."""

    duration: float | None = None
    ready_file: Path | None = None


class Ages:
    """How old updates are when they are shown: s from publication, of the last hour at 10 Hz."""

    def __init__(self) -> None:
        self.shown = 0
        self._recent: deque[float] = deque(maxlen=_AGES_KEPT)

    def add(self, age: float) -> None:
        """Take in the age of an update that has just been shown."""
        self.shown += 1
        self._recent.append(age)

    @property
    def newest(self) -> float | None:
        """That of the last update; None before the first."""
        return self._recent[-1] if self._recent else None

    def summary(self) -> dict[str, float | None]:
        """Median, 99th percentile and largest, in s; None without any."""
        if not self._recent:
            return {"median": None, "p99": None, "max": None}
        median, p99, largest = np.percentile(np.array(self._recent), (50, 99, 100)).tolist()
        return {"median": median, "p99": p99, "max": largest}


@dataclass(frozen=True)
class Viewed:
    """What was shown, and what was not: `lost` on the way, `dropped` because the display was slow."""

    updates: int
    lost: int
    dropped: int
    age_s: dict[str, float | None]

    def line(self) -> str:
        """The result in words."""
        line = f"{self.updates} updates shown, {self.lost} lost, {self.dropped} dropped"
        median, p99 = self.age_s["median"], self.age_s["p99"]
        if median is None or p99 is None:
            return line
        return f"{line}; age when shown: median {1e3 * median:.0f} ms, 99 % within {1e3 * p99:.0f} ms"


class _Feed:
    """The subscriptions of one scene, emptied into a picture."""

    def __init__(self, session: zenoh.Session, scene: str) -> None:
        self.picture = ScenePicture(scene)
        self._presence = Presence(session, scene)
        self._truths = Subscription(session, TruthBatch, scene)
        self._statuses = Subscription(session, Status, scene)
        self._batches = Subscription(session, ObservationBatch, scene, capacity=8192)
        self._previews = Subscription(session, Preview, scene)
        self.updates = Subscription(session, HypothesisUpdate, scene, capacity=UPDATES_KEPT)
        self.published_ns: int | None = None

    def poll(self) -> list[Moment]:
        """Take in everything that has come; answers with what there is to show."""
        picture, now, wall_ns = self.picture, time.monotonic(), time.time_ns()
        for role, name, alive in self._presence.drain():
            picture.on_presence(role, name, alive=alive, now=now)
        for _, truth in self._truths.drain():
            picture.on_truth(truth)
        for arrived, batch in self._batches.drain():
            picture.on_batch(batch, arrived, wall_ns - round((now - arrived) * 1e9))
        for _, status in self._statuses.drain():
            picture.on_status(status)
        for arrived, preview in self._previews.drain():
            picture.on_preview(preview, arrived)
        moments: list[Moment] = []
        self.published_ns = None
        for arrived, update in self.updates.drain():
            moments += picture.on_update(update, arrived)
            self.published_ns = update.published_ns
        return moments + picture.tick(now)

    def close(self) -> None:
        """Undeclare everything."""
        for subscription in (
            self._presence,
            self._truths,
            self._statuses,
            self._batches,
            self._previews,
            self.updates,
        ):
            subscription.close()


def view(
    sink: Sink,
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    options: ViewOptions | None = None,
) -> Viewed:
    """Show a scene until it is told to stop, the time is over, or the window is closed.

    Raises
    ------
    ValueError
        If the scene is no valid name, or an endpoint is wrong.
    """
    options, ages = options or ViewOptions(), Ages()
    feeds: list[_Feed] = []
    presence = Component(
        role="viewer",
        name=f"view-{new_session_id()[:8]}",
        scene=scene,
        settings=settings,
        ready_file=options.ready_file,
        status=lambda: _status(feeds, ages),
    )
    with presence as component, closing(_Feed(component.session, scene)) as feed:
        feeds.append(feed)
        component.ready()
        end = None if options.duration is None else time.monotonic() + options.duration
        while not component.stop.wait(TICK_S) and not sink.closed:
            _step(feed, sink, ages)
            if end is not None and time.monotonic() >= end:
                break
        return Viewed(ages.shown, feed.updates.counters.lost, feed.updates.dropped, ages.summary())


def _step(feed: _Feed, sink: Sink, ages: Ages) -> None:
    moments = feed.poll()
    sink.arrange(feed.picture.layout)
    sink.show(moments)
    if feed.published_ns is not None:
        ages.add((time.time_ns() - feed.published_ns) / 1e9)
        feed.picture.view_age = ages.newest


def _status(feeds: list[_Feed], ages: Ages) -> StatusFields:
    """What the viewer tells about itself, once a second."""
    counters: dict[str, int] = {"updates": ages.shown}
    for feed in feeds:
        counters |= {"lost": feed.updates.counters.lost, "dropped": feed.updates.dropped}
    newest = ages.newest
    return StatusFields(ages={} if newest is None else {"hypotheses": newest}, counters=counters)


def view_messages(messages: Iterable[tuple[int, Message]], scene: str, sink: Sink) -> int:
    """Show a recording at once: its own time line is what is played then.

    Parameters
    ----------
    messages
        (Receipt in ns, message), in order.
    scene
        Its name.

    Returns
    -------
    How many updates were shown.
    """
    picture, updates = ScenePicture(scene), 0
    for moments, message in _replayed(picture, messages):
        sink.arrange(picture.layout)
        sink.show(moments)
        updates += isinstance(message, HypothesisUpdate)
    return updates


def _replayed(
    picture: ScenePicture, messages: Iterable[tuple[int, Message]]
) -> Iterator[tuple[list[Moment], Message]]:
    for log_ns, message in messages:
        now = log_ns / 1e9
        moments: list[Moment] = []
        match message:
            case ObservationBatch():
                picture.on_batch(message, now, log_ns)
            case TruthBatch():
                picture.on_truth(message)
            case Status():
                picture.on_status(message)
            case Preview():
                picture.on_preview(message, now)
            case HypothesisUpdate():
                moments = picture.on_update(message, now)
        yield moments + picture.tick(now), message
