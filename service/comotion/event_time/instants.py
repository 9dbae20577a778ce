"""A batch on its way through event time, and what comes out: instants, and the ends of sessions."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, RejectionReason

from ..arrays import Stamps
from .stats import Fate, Key

Indices = NDArray[np.intp]
Rank = tuple[int, str, int]
"""First stamp, source, and order of arrival."""
NO_STAMPS, NO_ROWS = np.zeros(0, np.int64), np.zeros(0, np.intp)
# Python objects of a batch.
_OBJECT_BYTES = 1500


@dataclass(eq=False)
class Entry:
    """A batch on its way through event time.

    Attributes
    ----------
    batch
        What came in.
    repeated
        Whether its sequence number was seen before.
    size
        Bytes that it holds.
    judged
        Whether it has been compared with the clock.
    at_ns
        When it was first looked at, on the clock of arrivals.
    offset_ns
        Its stamp minus the time then.
    stamps, rows
        What of it waits for the watermark, as of :class:`Instants`.
    generation, order
        Which session of its source sent it, and which of the batches that wait it is.
    out
        How many of its instants have come out and are not booked.
    kept, late, refused
        Whether some of its instants were fused, some were too late, and why some were refused.
    """

    batch: ObservationBatch
    repeated: bool = False
    size: int = 0
    judged: bool = False
    at_ns: int = 0
    offset_ns: int = 0
    stamps: Stamps = field(default_factory=lambda: NO_STAMPS)
    rows: Indices = field(default_factory=lambda: NO_ROWS)
    generation: int = 0
    order: int = 0
    out: int = 0
    kept: bool = False
    late: bool = False
    refused: RejectionReason | None = None

    @property
    def key(self) -> Key:
        """Source and session."""
        return self.batch.source, self.batch.session

    @property
    def rank(self) -> Rank:
        """What decides when it comes out."""
        return int(self.stamps[0]), self.batch.source, self.order

    def __lt__(self, other: Self) -> bool:
        return self.rank < other.rank

    def take(self, watermark_ns: int, others: Iterable[Rank], session: int) -> "Instants":
        """Take the rows up to the watermark and to the ranks of others, as of a session number."""
        stop, mine = int(np.searchsorted(self.stamps, watermark_ns, side="right")), self.rank[1:]
        for stamp_ns, *other in others:
            side: Literal["left", "right"] = "right" if mine < tuple(other) else "left"
            stop = min(stop, int(np.searchsorted(self.stamps, stamp_ns, side=side)))
        taken = Instants(self.stamps[:stop], self.rows[:stop], session, self, last=stop == len(self.stamps))
        self.stamps, self.rows = self.stamps[stop:], self.rows[stop:]
        self.out += 1
        return taken

    @property
    def fate(self) -> Fate | None:
        """What became of it; None while some of it waits, or has come out and is not booked."""
        if self.out or len(self.stamps):
            return None
        if self.kept:
            return "partly_late" if self.late else "fused"
        return self.refused or "late"


@dataclass(frozen=True)
class Instants:
    """Released rows of one batch, with no instant of another batch between them.

    Attributes
    ----------
    stamps
        int64 [n], ascending, ns on the time scale of the scene; of each row, or [1] where there is none.
    rows
        intp [n]: the rows of the batch, ascending within one instant; none where `ended` alone counts.
    session
        Number of the (source, session) that sent it.
    entry
        The batch on its way.
    last
        Whether nothing of the batch is left.
    """

    stamps: Stamps
    rows: Indices
    session: int
    entry: Entry
    last: bool

    @property
    def batch(self) -> ObservationBatch:
        """The whole batch."""
        return self.entry.batch

    @property
    def stamp_ns(self) -> int:
        """The first stamp."""
        return int(self.stamps[0])


@dataclass(frozen=True)
class SessionEnded:
    """A source has started a new session, or was forgotten: trajectories of session `session` are over."""

    session: int


def in_time_order(batch: ObservationBatch) -> tuple[Stamps, Indices]:
    """Stamps of the rows of a batch, int64 [n] ascending, and the rows, intp [n], ascending for each stamp.

    A batch without rows has one stamp, its own.
    """
    stamps = batch.stamps_ns
    if stamps is None or not len(stamps):
        count = len(batch.ids)
        return np.full(max(count, 1), batch.stamp_ns), np.arange(count)
    order = np.argsort(stamps, kind="stable")
    return stamps[order], order


def count_instants(batch: ObservationBatch) -> int:
    """How many different acquisition times a batch has."""
    if batch.stamps_ns is None or len(batch.stamps_ns) < 2:
        return 1
    return len(np.unique(batch.stamps_ns))


def size_of(batch: ObservationBatch) -> int:
    """Bytes that a batch holds."""
    return _OBJECT_BYTES + sum(
        value.nbytes for value in vars(batch).values() if isinstance(value, np.ndarray)
    )
