"""Shows a running scene or a recording in Foxglove, by the WebSocket server of its SDK."""

from typing import Self

import foxglove

from comotion_schemas.naming import Names

from .scene import FoxgloveScene

LOOPBACK = "127.0.0.1"
_BACKLOG = 256
"""Messages that wait for a slow client; then the oldest are dropped."""


class FoxgloveDisplay(FoxgloveScene):
    """Serves a scene to Foxglove; a context manager, for a running scene or a recording.

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

    def __init__(self, port: int, names: Names | None = None) -> None:
        context = foxglove.Context()
        super().__init__(context, names)
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
