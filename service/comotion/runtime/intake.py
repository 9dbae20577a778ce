"""Decodes and checks observation batches in turn; each source has a share of the time."""

import logging
import time
from collections.abc import Iterator

import zenoh

from comotion_schemas import DecodeError, Keys, ObservationBatch, decode_as
from comotion_schemas.types import is_name

from ..event_time.stats import Ledger
from .log_limit import LogLimit
from .queues import OTHERS, Payload, Queues
from .statuses import Statuses
from .tokens import Tokens

_log = logging.getLogger(__name__)


class Intake:
    """All that the service subscribes to of so many sources; refusals and overflow go to the ledger.

    Attributes
    ----------
    rejection
        On whose key the newest payload came that was refused, and why; empty before any.
    tokens, queues, statuses
        Which sources are there, what has come of them, and what they say.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, ledger: Ledger, most: int = 1024) -> None:
        self._ledger = ledger
        self._most = most
        self._limit = LogLimit(10, 10.0)
        self.rejection = ""
        self.tokens = Tokens(session, keys, most)
        self.queues = Queues(session, keys, most)
        self.statuses = Statuses(session, keys, most)

    @property
    def received(self) -> dict[str, int]:
        """Valid batches of every source that has lately sent."""
        return self.queues.received()

    @property
    def present(self) -> dict[str, int]:
        """Names whose liveliness token is there, and since when in monotonic ns."""
        return self.tokens.present

    def silent_ns(self, monotonic_ns: int) -> int:
        """Time since a payload of any source arrived."""
        return monotonic_ns - self.queues.heard_ns()

    def receive(self, monotonic_ns: int, budget_ns: int = 2**62) -> Iterator[ObservationBatch]:
        """Yield valid batches that have arrived: of each source in the order of arrival, in turns.

        Parameters
        ----------
        monotonic_ns
            Now, on the monotonic clock.
        budget_ns
            For reading and whatever the caller does with a batch. Beyond it, a source that has had its share
            waits for the next call; any source may have one batch read.
        """
        self.tokens.look(monotonic_ns, self._known)
        active = self.queues.active()
        share_ns, total_ns, spent = budget_ns // max(len(active), 1), 0, dict.fromkeys(active, 0)
        while active:
            for name, queue in list(active.items()):
                began = time.monotonic_ns()
                payload, displaced = self.queues.take(queue)
                if displaced:
                    self._ledger.overflow((name, ""), displaced)
                    self._ledger.overlooked(name, displaced)
                batch = self._batch(name, payload)
                if batch is not None:
                    queue.received += 1
                    yield batch
                took_ns = time.monotonic_ns() - began
                total_ns += took_ns
                spent[name] += took_ns
                if not queue.waiting or (total_ns > budget_ns and spent[name] >= share_ns):
                    del active[name]

    def _known(self) -> set[str]:
        """Names of which something has come: batches, or Statuses since the last call."""
        return self.queues.received().keys() | self.statuses.take_sources()

    def drop_idle(self, monotonic_ns: int) -> None:
        """Forget sources that have left and sent nothing for some seconds."""
        self.queues.drop_idle(monotonic_ns, set(self.present))

    def close(self) -> None:
        """Stop receiving."""
        self.queues.close()
        self.statuses.close()

    def _batch(self, queue: str, payload: Payload) -> ObservationBatch | None:
        """The batch in a payload of a queue; None where it is refused."""
        name, content = payload
        try:
            if queue == OTHERS and is_name(name):
                raise DecodeError("limit", f"more than {self._most} sources")
            batch = decode_as(ObservationBatch, content)
            if batch.source != name:
                raise DecodeError("source-mismatch", f"source {batch.source!r} on the key of {name!r}")
        except DecodeError as error:
            self._reject(name, error)
        except Exception as error:  # a defect of the codec costs one payload
            self._reject(name, DecodeError("defect", f"{type(error).__name__}: {error}"[:500]))
            _log.debug("decoding failed", exc_info=True)
        else:
            return batch
        return None

    def _reject(self, name: str, error: DecodeError) -> None:
        known = name if is_name(name) else ""
        self._ledger.refuse((known, ""), error.reason)
        if known:
            self._ledger.overlooked(known, 1)
        self.rejection = f"obs/{name}: {error}"
        self._limit.log(_log, logging.WARNING, "rejected a batch on obs/%s: %s", name[:64], error)
