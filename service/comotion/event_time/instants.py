"""A batch in, its rows grouped by acquisition time out; and the two events that event time gives out."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, RejectionReason

from .stats import Key

Indices = NDArray[np.intp]


@dataclass(eq=False)
class Entry:
    """A batch on its way through event time, until its account is settled.

    Attributes
    ----------
    batch
        What came in.
    repeated
        Whether its sequence number was seen before.
    size
        Bytes that it holds.
    at_ns
        When it was first looked at, on the clock of arrivals.
    offset_ns
        Its stamp minus the time then.
    left
        Its instants that have not come out.
    kept, late, refused
        Whether some were fused, some were too late, and why some were refused.
    """

    batch: ObservationBatch
    repeated: bool = False
    size: int = 0
    at_ns: int = 0
    offset_ns: int = 0
    left: int = 0
    kept: bool = False
    late: bool = False
    refused: RejectionReason | None = None

    @property
    def key(self) -> Key:
        """Source and session."""
        return self.batch.source, self.batch.session


@dataclass(frozen=True)
class Instant:
    """Released rows of one batch that share one acquisition time.

    Attributes
    ----------
    stamp_ns
        Acquisition time on the time scale of the scene, nanoseconds.
    batch
        The whole batch.
    rows
        intp [n], ascending: the rows of the batch of this instant; none where `ended` alone counts.
    session
        Number of the (source, session) that sent it.
    in_order
        False where the watermark had passed the stamp when the batch came.
    last
        Whether this is the newest instant of its batch.
    entry
        The account of the batch; None where it is settled already.
    """

    stamp_ns: int
    batch: ObservationBatch
    rows: Indices
    session: int
    in_order: bool
    last: bool
    entry: Entry | None = None


@dataclass(frozen=True)
class SessionEnded:
    """A source has started a new session, or was forgotten: trajectories of session `session` are over."""

    session: int


def split(batch: ObservationBatch) -> list[tuple[int, Indices]]:
    """Acquisition times of a batch, ascending, each with its rows, ascending (intp [n]).

    A batch without rows has one instant, its own stamp.
    """
    stamps = batch.stamps_ns
    if stamps is None or not len(stamps):
        return [(batch.stamp_ns, np.arange(len(batch.ids)))]
    order = np.argsort(stamps, kind="stable")
    in_order = stamps[order]
    cuts = np.flatnonzero(in_order[1:] != in_order[:-1]) + 1
    bounds = [0, *cuts.tolist(), len(order)]
    # Slices: np.split takes ten times as long.
    return [(int(in_order[first]), order[first:stop]) for first, stop in pairwise(bounds)]


def count_instants(batch: ObservationBatch) -> int:
    """How many different acquisition times a batch has."""
    if batch.stamps_ns is None or len(batch.stamps_ns) < 2:
        return 1
    ordered = np.sort(batch.stamps_ns)
    return 1 + int(np.count_nonzero(ordered[1:] != ordered[:-1]))


def size_of(batch: ObservationBatch) -> int:
    """Bytes that a batch holds."""
    columns = vars(batch).values()
    return _OBJECT_BYTES + sum(column.nbytes for column in columns if isinstance(column, np.ndarray))


# Python objects of a batch and of one instant of it.
_OBJECT_BYTES = 1500
