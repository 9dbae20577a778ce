"""The viewer process: subscriptions of a scene -> shapes -> sink.

It reads from bounded rings and inboxes that drop the oldest messages, so that a slow display does not
delay other components.
"""

import logging
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
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
from comotion_schemas.component import Component, StatusFields, viewer_name
from comotion_schemas.naming import Names
from comotion_schemas.transport import SessionSettings

from ..presence import Presence
from ..subscription import Subscription
from .picture import ScenePicture
from .shapes import Layout, Moment

POLL_S = 0.02
UPDATES_KEPT = 4
"""Updates kept while the display is slow; older ones are dropped."""
_AGES_KEPT = 36_000  # one hour at 10 Hz
_log = logging.getLogger(__name__)


class Sink(Protocol):
    """Output of shapes."""

    @property
    def closed(self) -> bool:
        """Whether the user has closed the window."""

    def arrange(self, layout: Layout) -> None:
        """Arrange the views."""

    def show(self, moments: Iterable[Moment]) -> None:
        """Show moments; returns when they are delivered."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """How long to show a scene, and how often.

    Attributes
    ----------
    duration
        s; None: until stopped.
    rate
        Most updates, and images of a camera, drawn per second; None: all.
    ready_file
        File to write once the viewer is subscribed.
    dense
        Whether to draw the regions of hypotheses in images.
    names
        Names of hypotheses by id.
    """

    duration: float | None = None
    rate: float | None = None
    ready_file: Path | None = None
    dense: bool = False
    names: Names = field(default_factory=dict)


class Ages:
    """Ages of updates when they are shown, in s since publication, over the last hour at 10 Hz."""

    def __init__(self) -> None:
        self.shown = 0
        self._recent: deque[float] = deque(maxlen=_AGES_KEPT)

    def add(self, age: float) -> None:
        """Add the age of an update that was shown."""
        self.shown += 1
        self._recent.append(age)

    @property
    def newest(self) -> float | None:
        """Age of the last update; None before the first."""
        return self._recent[-1] if self._recent else None

    def summary(self) -> dict[str, float | None]:
        """Median, 99th percentile and largest age, in s; None without any."""
        if not self._recent:
            return {"median": None, "p99": None, "max": None}
        median, p99, largest = np.percentile(np.array(self._recent), (50, 99, 100)).tolist()
        return {"median": median, "p99": p99, "max": largest}


@dataclass(frozen=True)
class Viewed:
    """Result: updates shown, `lost` in transport, and `dropped` because the display was slow."""

    updates: int
    lost: int
    dropped: int
    age_s: dict[str, float | None]

    def line(self) -> str:
        """Format the result as one line."""
        line = f"{self.updates} updates shown, {self.lost} lost, {self.dropped} dropped"
        median, p99 = self.age_s["median"], self.age_s["p99"]
        if median is None or p99 is None:
            return line
        return f"{line}; age when shown: median {1e3 * median:.0f} ms, 99 % within {1e3 * p99:.0f} ms"


class _Feed:
    """Fills a scene picture from the subscriptions of one scene."""

    def __init__(self, session: zenoh.Session, scene: str, options: ViewOptions) -> None:
        self.picture = ScenePicture(scene, options.rate, dense=options.dense, names=options.names)
        self._presence = Presence(session, scene)
        self._truths = Subscription(session, TruthBatch, scene)
        self._statuses = Subscription(session, Status, scene)
        self._batches = Subscription(session, ObservationBatch, scene, capacity=8192)
        self._previews = Subscription(session, Preview, scene)
        self.updates = Subscription(session, HypothesisUpdate, scene, capacity=UPDATES_KEPT)
        self.published_ns: int | None = None

    def poll(self) -> list[Moment]:
        """Process received messages; returns the shapes to show."""
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
    """Show a scene until a signal arrives, the duration is over, or the window is closed.

    Parameters
    ----------
    sink
        Output of the shapes.
    scene, settings
        Name of the scene; how to connect.
    options
        Duration and ready file.

    Raises
    ------
    ValueError
        If the scene name or an endpoint is not valid.
    """
    options, ages = options or ViewOptions(), Ages()
    feeds: list[_Feed] = []
    presence = Component(
        role="viewer",
        name=viewer_name("view", settings),
        scene=scene,
        settings=settings,
        ready_file=options.ready_file,
        status=lambda: _status(feeds, ages),
    )
    with presence as component, closing(_Feed(component.session, scene, options)) as feed:
        feeds.append(feed)
        component.ready()
        end = None if options.duration is None else time.monotonic() + options.duration
        while not component.stop.wait(POLL_S) and not sink.closed:
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
    """Build the Status of the viewer."""
    counters: dict[str, int] = {"updates": ages.shown}
    for feed in feeds:
        counters |= {"lost": feed.updates.counters.lost, "dropped": feed.updates.dropped}
    newest = ages.newest
    return StatusFields(ages={} if newest is None else {"hypotheses": newest}, counters=counters)


def view_messages(
    messages: Iterable[tuple[int, Message]],
    scene: str,
    sink: Sink,
    *,
    dense: bool = False,
    names: Names | None = None,
) -> int:
    """Send a recording to a sink as fast as possible; the viewer then plays it.

    Parameters
    ----------
    messages
        (Time of receipt in ns, message), in order.
    scene
        Name of the scene.
    dense, names
        As in :class:`ViewOptions`.

    Returns
    -------
    Number of updates shown.
    """
    picture, updates = ScenePicture(scene, dense=dense, names=names), 0
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
