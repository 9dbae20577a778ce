"""Publishes updates and answers queries while this service is the one of its scene.

A standby (:mod:`.standby`) computes the same updates and keeps them to itself.
"""

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from comotion_schemas import HypothesisUpdate, encode
from comotion_schemas.component import Component
from comotion_schemas.keys import QueryName
from comotion_schemas.transport import Publisher, declare_publisher

from .presence import Presence
from .queries import Handler, Queryables
from .standby import Election

_log = logging.getLogger(__name__)


@dataclass
class Output:
    """The publisher and the queryables of a service, declared while it speaks for its scene.

    A service that has fallen silent undeclares its publisher: its cache would give its last update to late
    joiners. `leadership` says whether this service speaks.
    """

    component: Component
    leadership: Presence | Election
    handlers: Mapping[QueryName, Handler]
    _epoch: int | None = None
    _publisher: Publisher | None = None
    _queryables: Queryables | None = None

    def publish(self, update: HypothesisUpdate) -> HypothesisUpdate:
        """Publish an update with the time of its publication; returns what was, or would have been."""
        epoch = self.leadership.epoch
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
        scene = self.component.keys.scene
        if epoch is None:
            if isinstance(self.leadership, Election):
                _log.warning("another service may speak for scene %r: this one is a standby now", scene)
            if self._publisher is not None and self._queryables is not None:
                self._publisher.undeclare()
                self._queryables.close()
            self._publisher = self._queryables = None
        elif self._publisher is None:
            if epoch:
                _log.warning("this service speaks for scene %r now, epoch %d", scene, epoch)
            keys, session = self.component.keys, self.component.session
            self._publisher = declare_publisher(session, keys.hypotheses, "hypotheses")
            self._queryables = Queryables(session, keys, self.handlers)
        self._epoch = epoch
