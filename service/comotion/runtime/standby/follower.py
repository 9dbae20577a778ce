"""Follows the active service of a scene: its ids, and whether it is still there.

A standby gives its hypotheses the ids of what the active service publishes, and watches the active service's
liveliness token.
"""

import logging
import time

from zenoh import Sample, SampleKind
from zenoh.handlers import RingChannel

from comotion_schemas import DecodeError, HypothesisUpdate, decode_as
from comotion_schemas.component import Component
from comotion_schemas.keys import last_chunk
from comotion_schemas.sequence import Epochs
from comotion_schemas.transport import declare_subscriber

from ...fusion import Fusion
from ..intake import Intake
from .election import Election

# Updates and tokens between two turns of the loop; the newest are kept.
_MOST_UPDATES = 64
# s; a router answers within milliseconds.
_TOKEN_TIMEOUT_S = 0.5
# Without an update for so long, the service queries the router for the token of the active service.
_QUIET_NS, _QUIET_PERIODS = 300_000_000, 3
# Zenoh takes a link for dead after 2 s; over one that works a source of 1 Hz is heard meanwhile.
_SILENT_NS = 1_500_000_000
_log = logging.getLogger(__name__)


class Follower:
    """Takes over the ids of the active service, and notices when it is gone.

    The fusion follows the ids of the active service; the intake knows whether observations arrive.
    """

    def __init__(self, component: Component, election: Election, fusion: Fusion, intake: Intake) -> None:
        self._component, self._election, self._fusion, self._intake = component, election, fusion, intake
        self._epochs = Epochs()
        self._queried_ns, self._period_ns = time.monotonic_ns(), 0
        keys, session = component.keys, component.session
        self._updates = declare_subscriber(session, keys.hypotheses, "hypotheses", RingChannel(_MOST_UPDATES))
        self._tokens = session.liveliness().declare_subscriber(
            keys.all_live("service"), RingChannel(_MOST_UPDATES)
        )

    def look(self) -> None:
        """Take in the updates that others have published, and which of them have gone."""
        newest = None
        while (sample := self._updates.try_recv()) is not None:
            newest = self._accept(sample) or newest
        now_ns = time.monotonic_ns()
        if newest is not None:
            self._queried_ns, self._period_ns = now_ns, newest.period_ns
            if self._election.epoch is None:
                self._fusion.follow(newest)
        while (token := self._tokens.try_recv()) is not None:
            if token.kind == SampleKind.DELETE:
                self._check(last_chunk(str(token.key_expr)))
        # Zenoh 1.10 does not report the end of every token.
        if now_ns - self._queried_ns > max(_QUIET_NS, _QUIET_PERIODS * self._period_ns):
            self._queried_ns = now_ns
            if self._election.leader is not None:
                self._check(self._election.leader)

    def _accept(self, sample: Sample) -> HypothesisUpdate | None:
        try:
            update = decode_as(HypothesisUpdate, sample.payload.to_bytes())
        except DecodeError as error:
            _log.debug("an update of another service is not valid: %s", error)
            return None
        now_s = time.monotonic()
        if update.session == self._component.session_id or not self._epochs.allows(update.epoch, now_s):
            return None
        self._epochs.follow(update.epoch, now_s)
        self._election.fence(update.epoch)
        return update

    def _check(self, name: str) -> None:
        """Report a service that is gone; the active service reports none, and none reports itself."""
        if self._election.epoch is None and name != self._component.name and self._is_gone(name):
            self._election.suspect(name)

    def _is_gone(self, name: str) -> bool:
        """Whether a token is gone for the router too: in a session that loses its router all seem gone.

        A replica that hears no source may be cut off itself, with its router, and takes no service for gone.
        """
        session = self._component.session
        silent_ns = time.monotonic_ns() - self._intake.heard_ns()
        if silent_ns > _SILENT_NS or not session.info.routers_zid():
            return False
        key = self._component.keys.live("service", name)
        alive = any(reply.ok is not None for reply in session.liveliness().get(key, timeout=_TOKEN_TIMEOUT_S))
        return not alive and bool(session.info.routers_zid())
