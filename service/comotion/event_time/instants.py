"""A batch on its way through event time, and what comes out: instants, and the ends of sessions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, RejectionReason

from ..arrays import Stamps
from .stats import Key

Indices = NDArray[np.intp]
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
    out, exhausted
        How many of its instants have come out and are not booked; whether no further ones will.
    kept, late, refused
        Whether some of its instants were fused, some were too late, and why some were refused.
    """

    batch: ObservationBatch
    repeated: bool = False
    size: int = 0
    judged: bool = False
    at_ns: int = 0
    offset_ns: int = 0
    out: int = 0
    exhausted: bool = False
    kept: bool = False
    late: bool = False
    refused: RejectionReason | None = None

    @property
    def key(self) -> Key:
        """Source and session."""
        return self.batch.source, self.batch.session


@dataclass(frozen=True)
class Instants:
    """Released rows of one batch, with no instant of another batch between them.

    Attributes
    ----------
    stamps
        int64 [n], ascending, ns on the time scale of the scene; of each row, or [1] where there is none.
    batch
        The whole batch.
    rows
        intp [n]: the rows of the batch, ascending within one instant; none where `ended` alone counts.
    session
        Number of the (source, session) that sent it.
    in_order
        False where the watermark had passed the first stamp when the batch came.
    last
        Whether nothing of the batch is left.
    entry
        The batch; None where it is settled already.
    """

    stamps: Stamps
    batch: ObservationBatch
    rows: Indices
    session: int
    in_order: bool
    last: bool
    entry: Entry | None = None

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
