"""Computed updates in; while this service speaks for its scene, published updates and answered queries out.

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
from comotion_schemas.keys import QueryName, last_chunk
from comotion_schemas.transport import Publisher, declare_publisher, declare_subscriber

from ..fusion import Fusion
from .election import Election, Leadership
from .queries import Handler, Queryables

# Updates and tokens between two turns of the loop; the newest are kept.
_MOST_UPDATES = 64
# s; a router answers within milliseconds.
_TOKEN_TIMEOUT_S = 0.5
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
    """

    def __init__(self, component: Component, election: Election, fusion: Fusion) -> None:
        self._component = component
        self._election = election
        self._fusion = fusion
        self._epoch = 0
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
        if newest is not None and self._election.epoch is None:
            self._fusion.follow(newest)
        while (token := self._tokens.try_recv()) is not None:
            self._note(token)

    def _accept(self, sample: Sample) -> HypothesisUpdate | None:
        try:
            update = decode_as(HypothesisUpdate, sample.payload.to_bytes())
        except DecodeError as error:
            _log.debug("an update of another service is not valid: %s", error)
            return None
        if update.session == self._component.session_id or update.epoch < self._epoch:
            return None
        self._epoch = update.epoch
        self._election.fence(update.epoch)
        return update

    def _note(self, token: Sample) -> None:
        key = str(token.key_expr)
        if token.kind == SampleKind.DELETE and self._is_gone(key):
            self._election.suspect(last_chunk(key))

    def _is_gone(self, key: str) -> bool:
        """Whether a token is gone for the router too: to a session that loses its router all seem to be."""
        session = self._component.session
        if not session.info.routers_zid():
            return False
        there = any(reply.ok is not None for reply in session.liveliness().get(key, timeout=_TOKEN_TIMEOUT_S))
        return not there and bool(session.info.routers_zid())
