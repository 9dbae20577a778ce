"""Publishes updates and answers queries while this service is the one of its scene.

A standby computes the same updates and keeps them to itself. It follows the ids of what the active service
publishes, and watches the active service's liveliness token.
"""

import logging
import time
from collections.abc import Mapping
from dataclasses import replace

from zenoh import Sample, SampleKind
from zenoh.handlers import RingChannel

from comotion_schemas import DecodeError, HypothesisUpdate, decode_as, encode
from comotion_schemas.component import Component
from comotion_schemas.epochs import Epochs
from comotion_schemas.keys import QueryName, last_chunk
from comotion_schemas.transport import Publisher, declare_publisher, declare_subscriber

from ..fusion import Fusion
from .election import Election, Leadership
from .intake import Intake
from .queries import Handler, Queryables

# Updates and tokens between two turns of the loop; the newest are kept.
_MOST_UPDATES = 64
# s; a router answers within milliseconds.
_TOKEN_TIMEOUT_S = 0.5
# Without an update for so long, the service queries the router for the token of the active service.
_QUIET_NS, _QUIET_PERIODS = 300_000_000, 3
# Zenoh takes a link for dead after 2 s; over one that works a source of 1 Hz is heard meanwhile.
_SILENT_NS = 1_500_000_000
_log = logging.getLogger(__name__)


class Output:
    """The publisher and the queryables of a service, declared while it speaks for its scene.

    A service that has fallen silent undeclares its publisher: its cache would give its last update to late
    joiners.

    Parameters
    ----------
    component
        The open component.
    leadership
        Whether this service speaks.
    handlers
        Of the queries.
    """

    def __init__(
        self, component: Component, leadership: Leadership, handlers: Mapping[QueryName, Handler]
    ) -> None:
        self._component = component
        self._leadership = leadership
        self._handlers = handlers
        self._epoch: int | None = None
        self._publisher: Publisher | None = None
        self._queryables: Queryables | None = None

    def publish(self, update: HypothesisUpdate) -> HypothesisUpdate:
        """Publish an update with the time of its publication; returns what was, or would have been."""
        epoch = self._leadership.epoch
        if epoch != self._epoch:
            self._switch(epoch)
        update = replace(update, published_ns=time.time_ns(), epoch=epoch or 0)
        if self._publisher is not None:
            self._publisher.put(encode(update))
        return update

    def answer(self, budget_ns: int) -> None:
        """Reply to queries that wait, until the time is up."""
        if self._queryables is not None:
            self._queryables.answer(budget_ns)

    def _switch(self, epoch: int | None) -> None:
        scene = self._component.keys.scene
        if epoch is None:
            if isinstance(self._leadership, Election):
                _log.warning("another service may speak for scene %r: this one is a standby now", scene)
            self._close()
        elif self._publisher is None:
            if epoch:
                _log.warning("this service speaks for scene %r now, epoch %d", scene, epoch)
            keys, session = self._component.keys, self._component.session
            self._publisher = declare_publisher(session, keys.hypotheses, "hypotheses")
            self._queryables = Queryables(session, keys, self._handlers)
        self._epoch = epoch

    def _close(self) -> None:
        if self._publisher is not None and self._queryables is not None:
            self._publisher.undeclare()
            self._queryables.close()
        self._publisher = self._queryables = None


class Follower:
    """What a replica learns from the others of its scene.

    Parameters
    ----------
    component
        The open component.
    election
        In which it takes part.
    fusion
        Follows the ids of the active service.
    intake
        Knows whether observations arrive.
    """

    def __init__(self, component: Component, election: Election, fusion: Fusion, intake: Intake) -> None:
        self._component = component
        self._election = election
        self._fusion = fusion
        self._intake = intake
        self._epochs = Epochs()
        self._asked_ns, self._period_ns = time.monotonic_ns(), 0
        keys, session = component.keys, component.session
        self._updates = declare_subscriber(session, keys.hypotheses, "hypotheses", RingChannel(_MOST_UPDATES))
        self._tokens = session.liveliness().declare_subscriber(
            keys.all_live("service"), RingChannel(_MOST_UPDATES)
        )

    def look(self) -> None:
        """Take in what the others have published, and which of them have gone."""
        newest = None
        while (sample := self._updates.try_recv()) is not None:
            newest = self._accept(sample) or newest
        now_ns = time.monotonic_ns()
        if newest is not None:
            self._asked_ns, self._period_ns = now_ns, newest.period_ns
            if self._election.epoch is None:
                self._fusion.follow(newest)
        while (token := self._tokens.try_recv()) is not None:
            if token.kind == SampleKind.DELETE:
                self._check(last_chunk(str(token.key_expr)))
        # Zenoh 1.10 does not report the end of every token.
        if now_ns - self._asked_ns > max(_QUIET_NS, _QUIET_PERIODS * self._period_ns):
            self._asked_ns = now_ns
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
        """Say so if a service is gone; for the active one and for itself, nobody is."""
        if self._election.epoch is None and name != self._component.name and self._is_gone(name):
            self._election.suspect(name)

    def _is_gone(self, name: str) -> bool:
        """Whether a token is gone for the router too: to a session that loses its router all seem to be.

        A replica that hears no source may be cut off itself, with its router, and takes nobody for gone.
        """
        session = self._component.session
        if self._intake.silent_ns(time.monotonic_ns()) > _SILENT_NS or not session.info.routers_zid():
            return False
        key = self._component.keys.live("service", name)
        there = any(reply.ok is not None for reply in session.liveliness().get(key, timeout=_TOKEN_TIMEOUT_S))
        return not there and bool(session.info.routers_zid())
