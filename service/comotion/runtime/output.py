"""Publishes updates and answers queries while this service is the one of its scene.

A standby (:mod:`.standby`) computes the same updates and keeps them to itself.
"""

import logging
import time
from collections.abc import Mapping
from dataclasses import replace

from comotion_schemas import HypothesisUpdate, encode
from comotion_schemas.component import Component
from comotion_schemas.keys import QueryName
from comotion_schemas.transport import Publisher, declare_publisher

from .presence import Presence
from .queries import Handler, Queryables
from .standby import Election

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
        self, component: Component, leadership: Presence | Election, handlers: Mapping[QueryName, Handler]
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
