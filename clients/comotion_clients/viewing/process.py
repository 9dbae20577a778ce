"""The viewer process: subscriptions of a scene -> a display, which draws shapes or logs to Foxglove.

It reads from bounded rings and inboxes that drop the oldest messages, so that a slow display does not
delay other components.
"""

import logging
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

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
from comotion_schemas.component import StatusFields, viewer
from comotion_schemas.naming import Names
from comotion_schemas.transport import SessionSettings

from ..feed import BATCHES_KEPT, SceneFeed
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


class Display(Protocol):
    """What is done with a scene's messages."""

    @property
    def closed(self) -> bool:
        """Whether the user has closed it."""

    def on_presence(self, role: str, name: str, *, alive: bool, now: float) -> None:
        """Process that a component entered or left the scene."""

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> None:
        """Add a message; `arrived` by ``time.monotonic()``, `wall_ns` by the wall clock."""

    def refresh(self, now: float) -> None:
        """Show what has come."""

    def on_age(self, age_s: float | None) -> None:
        """Learn how old the last update was when it was shown, s."""


class _Shapes:
    """Draws shapes to a sink."""

    def __init__(self, sink: Sink, picture: ScenePicture) -> None:
        self._sink, self._picture = sink, picture
        self._moments: list[Moment] = []
        self.on_presence = picture.on_presence

    @property
    def closed(self) -> bool:
        return self._sink.closed

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> None:
        self._moments += self._picture.on_message(message, arrived, wall_ns)

    def refresh(self, now: float) -> None:
        moments, self._moments = self._moments + self._picture.tick(now), []
        self._sink.arrange(self._picture.layout)
        self._sink.show(moments)

    def on_age(self, age_s: float | None) -> None:
        self._picture.view_age = age_s


# Truth and batches before the updates that are scored by them.
_READ: dict[type[Any], int | None] = {
    TruthBatch: None,
    ObservationBatch: BATCHES_KEPT,
    Status: None,
    Preview: None,
    HypothesisUpdate: UPDATES_KEPT,
}


class _Feed(SceneFeed):
    """Gives a display what arrives of one scene."""

    def __init__(self, session: zenoh.Session, scene: str) -> None:
        super().__init__(session, scene, _READ)
        self.updates = self.of[HypothesisUpdate]
        self.published_ns: int | None = None

    def pour(self, display: Display) -> None:
        """Give received messages to a display."""
        now = time.monotonic()
        self.published_ns = None
        for role, name, alive in self.presence():
            display.on_presence(role, name, alive=alive, now=now)
        for message, arrived, wall_ns in self.messages():
            display.on_message(message, arrived, wall_ns)
            if isinstance(message, HypothesisUpdate):
                self.published_ns = message.published_ns
        display.refresh(now)


def view(
    sink: Sink,
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    options: ViewOptions | None = None,
) -> Viewed:
    """Draw a scene until a signal arrives, the duration is over, or the window is closed.

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
    options = options or ViewOptions()
    picture = ScenePicture(scene, options.rate, dense=options.dense, names=options.names)
    return follow(_Shapes(sink, picture), scene, settings, options)


def follow(display: Display, scene: str, settings: SessionSettings | None, options: ViewOptions) -> Viewed:
    """Give a display the messages of a scene, as :func:`view` does."""
    ages = Ages()
    feeds: list[_Feed] = []
    ready, status = options.ready_file, lambda: _status(feeds, ages)
    presence = viewer("view", scene, settings, ready_file=ready, status=status)
    with presence as component, _Feed(component.session, scene) as feed:
        feeds.append(feed)
        component.ready()
        end = None if options.duration is None else time.monotonic() + options.duration
        while not component.stop.wait(POLL_S) and not display.closed:
            feed.pour(display)
            if feed.published_ns is not None:
                ages.add((time.time_ns() - feed.published_ns) / 1e9)
                display.on_age(ages.newest)
            if end is not None and time.monotonic() >= end:
                break
        return Viewed(ages.shown, feed.updates.counters.lost, feed.updates.dropped, ages.summary())


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
    display, updates = _Shapes(sink, ScenePicture(scene, dense=dense, names=names)), 0
    for log_ns, message in messages:
        now = log_ns / 1e9
        display.on_message(message, now, log_ns)
        display.refresh(now)
        updates += isinstance(message, HypothesisUpdate)
    return updates
