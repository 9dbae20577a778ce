"""What arrives of one scene, and the viewer process: it shows a scene or a recording in a display.

Messages of some types, and who comes and goes, are read in an open session, from bounded rings and inboxes
that drop the oldest messages, so that a slow display does not delay other components.
"""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np
import zenoh

from comotion_schemas import HypothesisUpdate, Keys, Message, ObservationBatch, Preview, Status, TruthBatch
from comotion_schemas.component import StatusFields, Where, viewer
from comotion_schemas.hypotheses import Event
from comotion_schemas.naming import Names
from comotion_schemas.types import is_name

from .scene_model import SceneModel
from .scoring import Scoring
from .subscription import Subscription

_BATCHES_KEPT = 8192
"""Batches that wait for a client: it reads all of them."""
_TOKENS_KEPT = 256
# Components whose token is followed, the first to arrive.
_FOLLOWED = 1024


class SceneFeed(ExitStack):
    """Subscriptions to messages and liveliness tokens of one scene; a context manager.

    Parameters
    ----------
    session
        An open Zenoh session.
    scene
        Name of the scene.
    kinds
        Types of messages in the order in which :meth:`messages` yields those that wait.
    updates_kept
        Updates that wait for a slow client; None: the default of a subscription.
    everybody
        Whether to follow the tokens of all, else those of services and of components whose Status has come:
        while anybody follows all, a router is busy for long where thousands of tokens go at once.

    Attributes
    ----------
    of
        Subscription by type of message.
    """

    def __init__(
        self,
        session: zenoh.Session,
        scene: str,
        kinds: Sequence[type[Any]],
        *,
        updates_kept: int | None = None,
        everybody: bool = False,
    ) -> None:
        super().__init__()
        self._session, self._keys = session, Keys(scene)
        kept = {ObservationBatch: _BATCHES_KEPT, HypothesisUpdate: updates_kept}
        self.of: dict[type[Any], Subscription[Any]] = {
            kind: self.enter_context(Subscription(session, kind, scene, capacity=kept.get(kind)))
            for kind in kinds
        }
        # Subscriptions by key.
        self._tokens: dict[str, Any] = {}
        self._everybody = everybody
        self._follow(self._keys.all_live("*" if everybody else "service"))

    def _follow(self, key: str) -> None:
        if key not in self._tokens and len(self._tokens) < _FOLLOWED:
            ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(_TOKENS_KEPT)
            subscriber: Any = self._session.liveliness().declare_subscriber(key, ring, history=True)
            self.callback(subscriber.undeclare)
            self._tokens[key] = subscriber

    def pour(self, model: SceneModel) -> list[tuple[Message, list[Event]]]:
        """Give a model or display what has arrived; returns the messages with their new events."""
        events = [(received[0], model.on_message(*received)) for received in self.messages()]
        for tokens in self._tokens.values():
            while (sample := tokens.try_recv()) is not None:
                role, token = str(sample.key_expr).split("/")[-2:]
                if is_name(token):
                    alive = sample.kind == zenoh.SampleKind.PUT
                    model.on_presence(role, token, alive=alive, now=time.monotonic())
        return events

    def messages(self) -> Iterator[tuple[Message, float, int]]:
        """Yield (message, arrival by ``time.monotonic()``, arrival by the wall clock in ns)."""
        ahead_ns = time.time_ns() - time.monotonic_ns()
        for subscription in self.of.values():
            for arrived, message in subscription.drain():
                if isinstance(message, Status) and message.role != "service" and not self._everybody:
                    self._follow(self._keys.live(message.role, message.component))
                yield message, arrived, round(arrived * 1e9) + ahead_ns


POLL_S = 0.02
UPDATES_KEPT = 4
"""Updates kept while the display is slow; older ones are dropped."""
_AGES_KEPT = 36_000  # one hour at 10 Hz


class Display(SceneModel):
    """A model of a scene that is drawn; this one draws nothing.

    `scoring` has the truth and what is observed; `age_s` is how old the last update was when it was shown.
    """

    def __init__(self, scene: str, names: Names | None = None) -> None:
        super().__init__(scene, names)
        self.scoring = Scoring()
        self.age_s: float | None = None

    @property
    def closed(self) -> bool:
        """Whether the user has closed it."""
        return False

    def refresh(self, now: float) -> None:
        """Show what has come."""


@dataclass(frozen=True)
class Viewed:
    """Result: updates shown, `lost` in transport, and `dropped` because the display was slow.

    `age_s`: median, 99th percentile and largest age of updates when they were shown, in s since publication,
    over the last hour at 10 Hz; None without any.
    """

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


# Truth and batches before the updates that are scored by them.
_READ = (TruthBatch, ObservationBatch, Status, Preview, HypothesisUpdate)


def follow(display: Display, duration: float | None = None, **where: Unpack[Where]) -> Viewed:
    """Give a display a running scene until a signal arrives, `duration` s are over, or it is closed."""
    ages: deque[float] = deque(maxlen=_AGES_KEPT)
    counts: dict[str, int] = {}

    def status() -> StatusFields:
        return StatusFields(ages={"hypotheses": ages[-1]} if ages else {}, counters=dict(counts))

    with (
        viewer("view", status=status, **where) as component,
        SceneFeed(component.session, component.scene, _READ, updates_kept=UPDATES_KEPT) as feed,
    ):
        component.ready()
        updates, shown = feed.of[HypothesisUpdate], 0
        end = float("inf") if duration is None else time.monotonic() + duration
        while not component.stop.wait(POLL_S) and not display.closed:
            messages = [message for message, _ in feed.pour(display)]
            display.refresh(time.monotonic())
            if new := [message for message in messages if isinstance(message, HypothesisUpdate)]:
                shown += 1
                ages.append((time.time_ns() - new[-1].published_ns) / 1e9)
                display.age_s = ages[-1]
            counts |= {"updates": shown, "lost": updates.counters.lost, "dropped": updates.dropped}
            if time.monotonic() >= end:
                break
        values = np.percentile(ages, (50, 99, 100)).tolist() if ages else [None] * 3
        age_s = dict(zip(("median", "p99", "max"), values, strict=True))
        return Viewed(shown, updates.counters.lost, updates.dropped, age_s)


def play(display: Display, messages: Iterable[tuple[int, Message]], *, in_time: bool = False) -> int:
    """Give a display a recording; returns the number of updates.

    `messages` are (time of receipt in ns, message) in order; `in_time` plays them at the speed of their
    times, else as fast as possible: the viewer then plays them.
    """
    begun_s, first_ns, updates = time.monotonic(), None, 0
    for log_ns, message in messages:
        first_ns = log_ns if first_ns is None else first_ns
        if in_time:
            time.sleep(max(0.0, begun_s + (log_ns - first_ns) / 1e9 - time.monotonic()))
        display.on_message(message, log_ns / 1e9, log_ns)
        display.refresh(log_ns / 1e9)
        updates += isinstance(message, HypothesisUpdate)
    return updates
