"""Presence: the liveliness tokens of the components of a scene."""

from typing import Any

import zenoh

from comotion_schemas import Keys
from comotion_schemas.types import is_name


class Presence:
    """Subscribes to the liveliness tokens of one scene in an open session."""

    def __init__(self, session: zenoh.Session, scene: str) -> None:
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(256)
        self._tokens: Any = session.liveliness().declare_subscriber(
            Keys(scene).all_live(), ring, history=True
        )

    def drain(self) -> list[tuple[str, str, bool]]:
        """Return the changes since the last call: (role, name, whether the component is alive)."""
        found = []
        while (sample := self._tokens.try_recv()) is not None:
            role, name = str(sample.key_expr).split("/")[-2:]
            if is_name(name):
                found.append((role, name, sample.kind == zenoh.SampleKind.PUT))
        return found

    def close(self) -> None:
        """Undeclare the subscription."""
        self._tokens.undeclare()
