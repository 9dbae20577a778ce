"""What arrives of one scene: messages of some types, and who comes and goes, in an open session."""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

import zenoh

from comotion_schemas import HypothesisUpdate, Keys, Message, ObservationBatch, Status
from comotion_schemas.types import is_name

from .subscription import Subscription

_BATCHES_KEPT = 8192
"""Batches that wait for a client: it reads all of them."""
_TOKENS_KEPT = 256
# Components whose token is followed, the first to be heard.
_FOLLOWED = 1024


class Listener(Protocol):
    """Takes what arrives of a scene."""

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> Any:
        """Add a message; `arrived` by ``time.monotonic()``, `wall_ns` by the wall clock."""

    def on_presence(self, role: str, token: str, *, alive: bool, now: float) -> None:
        """Process that a component entered or left the scene."""


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

    def pour(self, listener: Listener) -> list[tuple[Message, Any]]:
        """Give a model or display what has arrived; returns the messages with what it has answered."""
        answers = [(received[0], listener.on_message(*received)) for received in self.messages()]
        for role, token, alive in self.presence():
            listener.on_presence(role, token, alive=alive, now=time.monotonic())
        return answers

    def messages(self) -> Iterator[tuple[Message, float, int]]:
        """Yield (message, arrival by ``time.monotonic()``, arrival by the wall clock in ns)."""
        ahead_ns = time.time_ns() - time.monotonic_ns()
        for subscription in self.of.values():
            for arrived, message in subscription.drain():
                if isinstance(message, Status) and message.role != "service" and not self._everybody:
                    self._follow(self._keys.live(message.role, message.component))
                yield message, arrived, round(arrived * 1e9) + ahead_ns

    def presence(self) -> Iterator[tuple[str, str, bool]]:
        """Yield who has come and gone: (role, last chunk of the token, whether the component is alive)."""
        for tokens in self._tokens.values():
            while (sample := tokens.try_recv()) is not None:
                role, name = str(sample.key_expr).split("/")[-2:]
                if is_name(name):
                    yield role, name, sample.kind == zenoh.SampleKind.PUT
