"""Counts batches, rows and updates for Status, with an account of every session.

Each batch that reaches the service is in exactly one of these: fused, partly late, late, duplicate, rejected
by reason, overflow, waiting. `batches` is their sum. What a session has sent is that sum and `lost`.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from comotion_schemas import RejectionReason
from comotion_schemas.sequence import Order, SequenceCounter

from ..saving import NOT_KEPT, plain, refill
from .troubles import Troubles

# A batch that was sent before a Status may arrive after it; and Statuses of a session within that time that
# count: two a second are read.
_GRACE_NS, _CLAIMS = 2_000_000_000, 8
# Accounts of single sessions that are kept; those not seen for longest go first. The totals hold them all.
MAX_ACCOUNTS = 4096

# Texts of the problem of a source whose batches are beyond a bound.
_BEYOND = {
    "overflow": "batches come faster than they can be read; send fewer or smaller ones",
    "limit": "batches are beyond a bound of `limits`; see docs/limits.md",
}

Key = tuple[str, str]


@dataclass
class Account:
    """Counts of the fates of the batches of one session, or of all."""

    batches: int = 0
    """Batches that came in: the sum of the others but `lost`."""
    fused: int = 0
    partly_late: int = 0
    late: int = 0
    """Batches that were stored; those of which some instants were too old; those that were all too old."""
    duplicates: int = 0
    """Batches seen before."""
    overflow: int = 0
    """Batches that were displaced by later ones of their source before they were read."""
    waiting: int = 0
    """Batches that wait for the watermark."""
    lost: int = 0
    """Batches that never came, as far as the sequence numbers tell. It goes down when one comes after all."""
    rejected: dict[RejectionReason, int] = field(default_factory=dict)
    """Batches refused, by reason."""

    def add(self, name: str, count: int = 1) -> None:
        """Count batches, by the name of a counter or the reason of a rejection."""
        if hasattr(self, name):
            setattr(self, name, getattr(self, name) + count)
        else:
            self.rejected[name] = self.rejected.get(name, 0) + count  # type: ignore[index, call-overload]


@dataclass
class Stats(Account):
    """The counters of Status: the account of all sessions, and what concerns no single batch."""

    observations: int = 0
    """Rows that were stored."""
    duplicate_rows: int = 0
    refused_rows: int = 0
    """Rows stored before; rows of batches that were fused that were beyond a bound, or that came back after
    their end."""
    reordered: int = 0
    """Batches with rows stored behind the watermark."""
    tracks: int = 0
    updates: int = 0
    """Trajectories opened, and updates computed."""
    overruns: int = 0
    """Deadlines missed by the service."""
    shed: int = 0
    """Updates that left out work, because updates took too long."""
    faults: int = 0
    """Errors of the service itself that cost a batch or the state of a space."""

    def counters(self) -> dict[str, int]:
        """The plain counters, without the rejections."""
        return {name: value for name, value in asdict(self).items() if isinstance(value, int)}


@dataclass
class Ledger:
    """Keeps the account of every session, and the totals; follows their sequence numbers."""

    total: Stats = field(metadata=NOT_KEPT)
    """The totals."""
    troubles: Troubles = field(default_factory=Troubles, metadata=NOT_KEPT)
    """Notes the sources whose batches are beyond a bound."""
    unknown: set[Key] = field(default_factory=set)
    """The newest sessions of an earlier run of the service of which nothing has come since: how much they
    have sent meanwhile is not known."""
    sequences: SequenceCounter = field(default_factory=lambda: SequenceCounter(from_zero=True))
    """The sequence numbers."""
    accounts: dict[Key, Account] = field(default_factory=dict)
    """Account of every (source, session), the one seen last at the end; session "" where unknown."""
    # Numbers of batches that sessions say they have sent, with the times at which they said so.
    _claims: dict[Key, deque[tuple[int, int]]] = field(default_factory=dict)
    # Of each source, batches that came in unread before the next one that is read.
    _unread: dict[str, int] = field(default_factory=dict, metadata=NOT_KEPT)

    def unread(self, source: str, fate: RejectionReason | Literal["overflow"], count: int = 1) -> None:
        """Batches of a source were refused or displaced before their sequence numbers were known.

        The source is empty where the name of none is valid.
        """
        self.book((source, ""), {"batches": count, fate: count})
        if source:
            self._unread[source] = self._unread.pop(source, 0) + count
            if len(self._unread) > MAX_ACCOUNTS:
                del self._unread[next(iter(self._unread))]

    def book(self, key: Key, counts: Mapping[str, int]) -> None:
        """Add to the account of a session and to the totals, by counter or by reason of a rejection."""
        own = self.accounts.pop(key, None) or Account()
        self.accounts[key] = own
        if len(self.accounts) > MAX_ACCOUNTS:
            idle = next((k for k, other in self.accounts.items() if not other.waiting), None)
            if idle is not None:
                del self.accounts[idle]
        for account in (self.total, own):
            for name, count in counts.items():
                account.add(name, count)
        for name in counts.keys() & _BEYOND.keys():
            self.troubles.note("limit", key[0], _BEYOND[name])

    def sight(self, key: Key, seq: int) -> Order:
        """Follow the sequence number of a batch; what is missing before it is lost."""
        self.unknown.discard(key)
        lost, order = self.sequences.sight(*key, seq)
        lost -= max(min(self._unread.pop(key[0], 0), lost), 0)
        if lost:
            self.book(key, {"lost": lost})
        return order

    def claim(self, key: Key, count: int, at_ns: int) -> None:
        """Take note that a session says it has sent so many batches, at a time on the clock of arrivals."""
        self.unknown.discard(key)
        self._claims.setdefault(key, deque(maxlen=_CLAIMS)).append((at_ns, count))
        if len(self._claims) > MAX_ACCOUNTS:
            del self._claims[next(iter(self._claims))]

    def miss(self, at_ns: int) -> None:
        """Count batches as lost that sessions have claimed for some time and that have not come."""
        for key, claims in list(self._claims.items()):
            while claims and at_ns - claims[0][0] >= _GRACE_NS:
                if lost := self.sequences.expect(*key, claims.popleft()[1]):
                    self.book(key, {"lost": lost})
            if not claims:
                del self._claims[key]

    def state(self) -> dict[str, Any]:
        """Accounts and totals as plain values; batches that wait do not survive and are lost."""
        return {**plain(self), "total": plain(self.total)}

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`; raises AttributeError, KeyError, TypeError or ValueError if it is none."""
        refill(self, state)
        refill(self.total, state["total"])
        self.unknown |= {source: session for source, session in self.accounts if session}.items()
        self.unknown &= self.accounts.keys()
        # The clock of arrivals has ended with the process: batches that were claimed then should be here.
        self._claims = {key: deque([(-_GRACE_NS, claims[-1][1])]) for key, claims in self._claims.items()}
        for account in (self.total, *self.accounts.values()):
            account.batches -= account.waiting
            account.lost += account.waiting
            account.waiting = 0
