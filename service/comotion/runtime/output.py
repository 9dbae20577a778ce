"""Publishes updates and answers queries while this service is the one of its scene.

A standby (:mod:`.standby`) computes the same updates and keeps them to itself. The queries, their parameters
and replies are those of docs/protocol.md; parameter values may be percent-encoded.

Every query gets a reply, or an error that says what is wrong.
"""

import json
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any
from urllib.parse import unquote

import msgpack
import numpy as np
import zenoh
from zenoh.handlers import RingChannel

from comotion_schemas import MAX_BYTES, QOS, HypothesisUpdate, Status, encode
from comotion_schemas.component import Component
from comotion_schemas.export import json_schemas
from comotion_schemas.keys import QueryName
from comotion_schemas.transport import Publisher, declare_publisher

from ..event_time.faults import Faults
from ..fusion import Fusion
from .log_limit import limited
from .presence import Presence
from .standby.election import Election

AFFINITY_SCHEMA = "comotion.Affinity/1"
_AFFINITY_ENCODING = f"application/msgpack;{AFFINITY_SCHEMA}"
_JSON = "application/json"
# Queries that wait for a turn of the loop; of more, the oldest are dropped.
_MOST_QUERIES = 64
_log = limited(__name__)

Answer = tuple[bytes, str]
Handler = Callable[[Mapping[str, str]], Answer]


class QueryError(Exception):
    """An invalid query; the text is sent to the querier."""


@dataclass
class Output:
    """The publisher and the queryables of a service, declared while it speaks for its scene.

    A service that has fallen silent undeclares its publisher: its cache would give its last update to late
    joiners. `leadership` says whether this service speaks.
    """

    component: Component
    leadership: Presence | Election
    handlers: Mapping[QueryName, Handler]
    faults: Faults
    _epoch: int | None = None
    _publisher: Publisher | None = None
    _queryables: deque[tuple[Any, QueryName]] = field(default_factory=deque)

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
        """Reply to queries that wait, in turns: to one at least, to no more once the time is up."""
        end, without_query = time.monotonic_ns() + budget_ns, 0
        while without_query < len(self._queryables):
            queryable, name = self._queryables[0]
            self._queryables.rotate(-1)
            query = queryable.try_recv()
            if query is None:
                without_query += 1
                continue
            with query:
                # The querier must learn of a defect, and the service go on.
                with self.faults.guard(f"answering query/{name}") as failed:
                    self._reply(query, name)
                if failed:
                    query.reply_err(f"internal error: {failed[0]!r}".encode(), encoding="text/plain")
            if time.monotonic_ns() >= end:
                return
            without_query = 0

    def _switch(self, epoch: int | None) -> None:
        keys, session = self.component.keys, self.component.session
        if epoch is None:
            if isinstance(self.leadership, Election):
                _log.warning("another service may speak for scene %r: this one is a standby now", keys.scene)
            if self._publisher is not None:
                self._publisher.undeclare()
            # Queries that wait get no reply.
            for queryable, _ in self._queryables:
                queryable.undeclare()
            self._publisher, self._queryables = None, deque()
        elif self._publisher is None:
            if epoch:
                _log.warning("this service speaks for scene %r now, epoch %d", keys.scene, epoch)
            self._publisher = declare_publisher(session, keys.hypotheses, "hypotheses")
            self._queryables = deque(
                (session.declare_queryable(keys.query(name), RingChannel(_MOST_QUERIES)), name)
                for name in self.handlers
            )
        self._epoch = epoch

    def _reply(self, query: zenoh.Query, name: QueryName) -> None:
        try:
            pairs = (pair.partition("=") for pair in str(query.parameters).split(";") if pair)
            parameters = {unquote(key): unquote(value) for key, _, value in pairs}
            payload, encoding = self.handlers[name](parameters)
            if len(payload) > MAX_BYTES:
                raise QueryError(f"the answer has {len(payload)} bytes, the limit is {MAX_BYTES}")
        except QueryError as error:
            query.reply_err(str(error).encode(), encoding="text/plain")
        else:
            query.reply(self.component.keys.query(name), payload, encoding=encoding)


def handlers(
    fusion: Fusion,
    last_update: Callable[[], HypothesisUpdate],
    status: Callable[[], Status],
) -> dict[QueryName, Handler]:
    """Build the handler of every queryable, from the update published last and the Status as of now."""
    return {
        "snapshot": lambda _: (encode(last_update()), QOS["hypotheses"].encoding),
        "status": lambda _: (encode(status()), QOS["status"].encoding),
        "config": lambda _: (fusion.config.model_dump_json().encode(), _JSON),
        "schema": lambda parameters: (_schema(parameters.get("message")), _JSON),
        "affinity": lambda parameters: (
            _affinity(fusion, parameters.get("space"), last_update().stamp_ns),
            _AFFINITY_ENCODING,
        ),
        "accounts": lambda _: (_accounts(fusion), _JSON),
        "forget": lambda parameters: (_forget(fusion, parameters.get("id")), _JSON),
    }


def _accounts(fusion: Fusion) -> bytes:
    listed, ledger = [], fusion.timeline.ledger
    for key, account in ledger.accounts.items():
        row = {"source": key[0], "session": key[1]} | asdict(account)
        listed.append(row | {"lost": None} if key in ledger.unknown else row)
    return json.dumps({"total": asdict(fusion.stats), "accounts": listed}).encode()


def _schema(message: str | None) -> bytes:
    schemas = json_schemas()
    if message is not None and message not in schemas:
        raise QueryError(f"no message {message!r}; one of {', '.join(schemas)}")
    return json.dumps(schemas if message is None else schemas[message]).encode()


def _forget(fusion: Fusion, which: str | None) -> bytes:
    if which is None or not (which == "all" or which.isdecimal()):
        raise QueryError("id is required: the id of a hypothesis, or all")
    forgotten = fusion.forget(None if which == "all" else int(which))
    if which != "all" and not forgotten:
        raise QueryError(f"no hypothesis {which}")
    return json.dumps({"forgotten": forgotten}).encode()


def _affinity(fusion: Fusion, space: str | None, stamp_ns: int) -> bytes:
    spaces = fusion.spaces
    if space is None and len(spaces) == 1:
        (space,) = spaces
    if space not in spaces:
        problem = "space is required" if space is None else f"no space {space!r}"
        raise QueryError(f"{problem}; known: {', '.join(spaces) or 'none yet'}")
    rows = spaces[space]
    if 4 * rows * rows > MAX_BYTES:
        raise QueryError(f"the affinities of {rows} trajectories exceed the limit of {MAX_BYTES} bytes")
    snapshot = fusion.affinity(space)
    index: dict[tuple[str, str], int] = {}
    owners = [index.setdefault((source, session), len(index)) for source, session, _ in snapshot.tracks]
    content: dict[str, Any] = {
        "schema": AFFINITY_SCHEMA,
        "space": space,
        "stamp_ns": stamp_ns,
        "sources": [{"name": name, "session": session} for name, session in index],
        "track_source": np.array(owners, "<u2").tobytes(),
        "track_id": np.array([track for *_, track in snapshot.tracks], "<u8").tobytes(),
        "matrix": np.ascontiguousarray(snapshot.matrix, "<f4").tobytes(),
    }
    payload: bytes = msgpack.packb(content)
    return payload
