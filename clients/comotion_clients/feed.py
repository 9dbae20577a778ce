"""What arrives of one scene: messages of some types, and who comes and goes, in an open session."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any, Self

import zenoh

from comotion_schemas import Keys, Message
from comotion_schemas.types import is_name

from .subscription import Subscription

BATCHES_KEPT = 8192
"""Batches that wait for a client that reads all of them."""
_TOKENS_KEPT = 256


class SceneFeed:
    """Subscriptions to messages and liveliness tokens of one scene; a context manager.

    Parameters
    ----------
    session
        An open Zenoh session.
    scene
        Name of the scene.
    capacities
        Types of messages in the order in which :meth:`messages` yields those that wait, each with the number
        of messages kept, None: the default of the type.

    Attributes
    ----------
    of
        Subscription by type of message.
    """

    def __init__(self, session: zenoh.Session, scene: str, capacities: dict[type[Any], int | None]) -> None:
        self._exit = ExitStack()
        self.of: dict[type[Any], Subscription[Any]] = {
            kind: self._exit.enter_context(Subscription(session, kind, scene, capacity=capacity))
            for kind, capacity in capacities.items()
        }
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(_TOKENS_KEPT)
        self._tokens: Any = session.liveliness().declare_subscriber(
            Keys(scene).all_live(), ring, history=True
        )
        self._exit.callback(self._tokens.undeclare)

    def messages(self) -> Iterator[tuple[Message, float, int]]:
        """Yield (message, arrival by ``time.monotonic()``, arrival by the wall clock in ns)."""
        ahead_ns = time.time_ns() - time.monotonic_ns()
        for subscription in self.of.values():
            for arrived, message in subscription.drain():
                yield message, arrived, round(arrived * 1e9) + ahead_ns

    def presence(self) -> Iterator[tuple[str, str, bool]]:
        """Yield who has come and gone: (role, last chunk of the token, whether the component is alive)."""
        while (sample := self._tokens.try_recv()) is not None:
            role, name = str(sample.key_expr).split("/")[-2:]
            if is_name(name):
                yield role, name, sample.kind == zenoh.SampleKind.PUT

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._exit.close()
