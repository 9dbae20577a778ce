"""A running scene or a recording -> Foxglove, by the WebSocket server of its SDK."""

import time
from collections.abc import Iterable
from typing import Self

import foxglove

from comotion_schemas import HypothesisUpdate, Message
from comotion_schemas.naming import Names

from .scene import FoxgloveScene

LOOPBACK = "127.0.0.1"
_BACKLOG = 256
"""Messages that wait for a slow client; then the oldest are dropped."""


class FoxgloveDisplay:
    """Serves a scene to Foxglove; a context manager, and a display of :mod:`..viewing.process`.

    Parameters
    ----------
    port
        TCP port on this machine alone; 0: a free one.
    names
        Names of hypotheses by id.

    Raises
    ------
    OSError
        If the port is in use.
    """

    closed = False

    def __init__(self, port: int, names: Names | None = None) -> None:
        context = foxglove.Context()
        self._scene = FoxgloveScene(context, names)
        try:
            self._server = foxglove.start_server(
                name="comotion", host=LOOPBACK, port=port, context=context, message_backlog_size=_BACKLOG
            )
        except Exception as error:  # the SDK's own, without a class for a port in use
            raise OSError(f"no server on {LOOPBACK}:{port}: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._server.stop()

    @property
    def url(self) -> str:
        """Where Foxglove finds the scene."""
        return f"ws://{LOOPBACK}:{self._server.port}"

    def on_presence(self, role: str, name: str, *, alive: bool, now: float) -> None:
        """Components are seen by their Status."""

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> None:  # noqa: ARG002
        """Log a message at the time of its receipt."""
        self._scene.add(wall_ns, message)

    def refresh(self, now: float) -> None:
        """Everything is sent at once."""

    def on_age(self, age_s: float | None) -> None:
        """Ages are in the numbers."""

    def play(self, messages: Iterable[tuple[int, Message]]) -> int:
        """Serve a recording at the speed of its times; returns the number of updates."""
        begun_s, first_ns, updates = time.monotonic(), None, 0
        for log_ns, message in messages:
            first_ns = log_ns if first_ns is None else first_ns
            time.sleep(max(0.0, begun_s + (log_ns - first_ns) / 1e9 - time.monotonic()))
            self._scene.add(log_ns, message)
            updates += isinstance(message, HypothesisUpdate)
        return updates
