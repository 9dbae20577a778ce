"""Decodes and checks observation batches in turn; each source has a share of the time."""

import logging
import time
from collections.abc import Iterator

import zenoh

from comotion_schemas import DecodeError, Keys, ObservationBatch, decode_as
from comotion_schemas.types import is_name

from ..event_time.stats import Ledger
from .log_limit import LogLimit
from .rings import Ring, Rings
from .statuses import Statuses
from .tokens import Tokens

_log = logging.getLogger(__name__)


class Intake:
    """All observation subscriptions of the service.

    `rejection` says on whose key the newest payload came that was refused, and why; empty before any.

    Parameters
    ----------
    session
        Open Zenoh session.
    keys
        Keys of the scene.
    ledger
        Where refusals and overflow are accounted.
    most
        Sources at a time.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, ledger: Ledger, most: int = 1024) -> None:
        self._ledger = ledger
        self._most = most
        self._limit = LogLimit(10, 10.0)
        self._received: dict[str, int] = {}
        self.rejection = ""
        self.tokens = Tokens(session, keys, most)
        self.rings = Rings(session, keys, self.tokens, most)
        self.statuses = Statuses(session, keys, most)

    @property
    def received(self) -> dict[str, int]:
        """Valid batches of every source that has a ring."""
        return {name: self._received.get(name, 0) for name in self.rings.of}

    @property
    def present(self) -> dict[str, int]:
        """Names whose liveliness token is there, and since when in monotonic ns."""
        return self.tokens.present

    def silent_ns(self, monotonic_ns: int) -> float:
        """Time since a payload of any source arrived; infinite if none has."""
        return min((monotonic_ns - ring.used_ns for ring in self.rings.of.values()), default=float("inf"))

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
        self.tokens.look(monotonic_ns)
        unknown, dropped = self.rings.gather(monotonic_ns)
        for name, count in dropped.items():
            known = name if is_name(name) else ""
            self._ledger.overflow((known, ""), count)
            self._ledger.overlooked(known, count)
        for name, sample in unknown:
            yield from self._check(name, sample)
        yield from self._in_turns(self._active(monotonic_ns), budget_ns)

    def _active(self, monotonic_ns: int) -> dict[str, Ring]:
        """Sources of which something is to be read."""
        active = {}
        for name, ring in self.rings.of.items():
            if ring.displaced:
                self._ledger.overflow((name, ""), ring.displaced)
                ring.displaced = 0
            if ring.pending:
                ring.used_ns, ring.spent_ns, active[name] = monotonic_ns, 0, ring
        return active

    def _in_turns(self, active: dict[str, Ring], budget_ns: int) -> Iterator[ObservationBatch]:
        share_ns, spent_ns = budget_ns // max(len(active), 1), 0
        while active:
            for name, ring in list(active.items()):
                began = time.monotonic_ns()
                item = self.rings.take(ring)
                if item.displaced != 0:
                    self._ledger.overlooked(name, item.displaced)
                yield from self._check(name, item.sample)
                took = time.monotonic_ns() - began
                ring.spent_ns += took
                spent_ns += took
                if not ring.pending or (spent_ns > budget_ns and ring.spent_ns >= share_ns):
                    del active[name]

    def drop_idle(self, monotonic_ns: int) -> None:
        """Forget sources that have left and sent nothing for some seconds."""
        self.rings.drop_idle(monotonic_ns)
        self._received = self.received

    def close(self) -> None:
        """Stop receiving; the subscriptions to observations end with the session."""
        self.rings.close()
        self.statuses.close()

    def _check(self, name: str, sample: zenoh.Sample) -> Iterator[ObservationBatch]:
        try:
            if name not in self.rings.of and is_name(name):
                raise DecodeError("limit", f"more than {self._most} sources")
            batch = decode_as(ObservationBatch, sample.payload.to_bytes())
            if batch.source != name:
                raise DecodeError("source-mismatch", f"source {batch.source!r} on the key of {name!r}")
        except DecodeError as error:
            self._reject(name, error)
            return
        except Exception as error:  # a defect of the codec costs one payload
            self._reject(name, DecodeError("defect", f"{type(error).__name__}: {error}"[:500]))
            _log.debug("decoding failed", exc_info=True)
            return
        self._received[name] = self._received.get(name, 0) + 1
        yield batch

    def _reject(self, name: str, error: DecodeError) -> None:
        known = name if is_name(name) else ""
        self._ledger.refuse((known, ""), error.reason)
        if known:
            self._ledger.overlooked(known, 1)
        self.rejection = f"obs/{name}: {error}"
        self._limit.log(_log, logging.WARNING, "rejected a batch on obs/%s: %s", name[:64], error)
