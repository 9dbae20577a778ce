"""A batch on its way through event time, and the instants that come out."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np

from comotion_schemas import ObservationBatch
from comotion_schemas.types import Unit

from ..arrays import Bools, Floats, Floats32, Ids, Ints, Stamps
from . import Event, Stage
from .stats import Key

Rank = tuple[int, str, int]
"""First stamp, source, and order of arrival."""
# Python objects of a batch.
_OBJECT_BYTES = 1500


@dataclass(eq=False)
class Entry:
    """A batch on its way through event time."""

    batch: ObservationBatch
    """What came in."""
    stage: Stage = Stage.ARRIVED
    repeated: bool = False
    """Whether its sequence number was seen before."""
    at_ns: int = 0
    """When it was first looked at, on the clock of arrivals."""
    offset_ns: int = 0
    """Its stamp minus the time then."""
    stamps: Stamps = field(default_factory=lambda: np.zeros(0, np.int64))
    rows: Ints = field(default_factory=lambda: np.zeros(0, np.intp))
    """Its rows that wait for the watermark, as of :class:`Instants`."""
    generation: int = 0
    order: int = 0
    """Number of the session of its source that sent it, and its own number in the order of arrival."""
    late: bool = False
    outcome: Event = "late"
    """Whether some of its instants were too late, and what has become of it so far."""

    def __post_init__(self) -> None:
        # Bytes that it holds.
        columns = (value for value in vars(self.batch).values() if isinstance(value, np.ndarray))
        self.size = _OBJECT_BYTES + sum(column.nbytes for column in columns)

    @property
    def key(self) -> Key:
        """Source and session."""
        return self.batch.source, self.batch.session

    @property
    def rank(self) -> Rank:
        """Order in which it comes out."""
        return int(self.stamps[0]), self.batch.source, self.order

    def __lt__(self, other: Self) -> bool:
        return self.rank < other.rank

    def take(self, watermark_ns: int, others: Iterable[Rank], session: int) -> "Instants":
        """Take the rows up to the watermark and to the ranks of others, as of a session number."""
        stop, own_rank = int(self.stamps.searchsorted(watermark_ns, "right")), self.rank[1:]
        for stamp_ns, *rank in others:
            side: Literal["left", "right"] = "right" if own_rank < tuple(rank) else "left"
            stop = min(stop, int(self.stamps.searchsorted(stamp_ns, side)))
        last = stop == len(self.stamps)
        taken = Instants(self.stamps[:stop], self.rows[:stop], session, self.batch, last)
        self.stamps, self.rows = self.stamps[stop:], self.rows[stop:]
        return taken


@dataclass(frozen=True)
class Instants:
    """Released rows of one batch, with no instant of another batch between them."""

    stamps: Stamps
    """int64 [n], ascending, ns on the time scale of the scene; of each row, or [1] where the batch has
    none."""
    rows: Ints
    """intp [n]: the rows of the batch, ascending within one instant; none where `ended` alone counts."""
    session: int
    """Number of the (source, session) that sent it."""
    batch: ObservationBatch
    """The whole batch."""
    last: bool
    """Whether nothing of the batch is left."""

    def of(self, rows: Bools) -> Self:
        """The same with some of the rows."""
        return self if rows.all() else replace(self, stamps=self.stamps[rows], rows=self.rows[rows])

    @cached_property
    def ids(self) -> Ids:
        """Ids of the rows, uint64 [n]."""
        return self.batch.ids[self.rows]

    @cached_property
    def positions(self) -> Floats:
        """Positions of the rows, float64 [n, dim]."""
        return self.batch.positions.take(self.rows, 0).astype(np.float64)

    @property
    def stamp_ns(self) -> int:
        """The first stamp."""
        return int(self.stamps[0])


def in_time_order(batch: ObservationBatch) -> tuple[Stamps, Ints]:
    """Stamps of the rows of a batch, int64 [n] ascending, and the rows, intp [n], ascending for each stamp.

    A batch without rows has one stamp, its own.
    """
    stamps = batch.stamps_ns
    if stamps is None or not len(stamps):
        count = len(batch.ids)
        return np.full(max(count, 1), batch.stamp_ns), np.arange(count)
    order = np.argsort(stamps, kind="stable")
    return stamps[order], order


def batch_of(source: str, seq: int, unit: Unit, positions: Floats32, **others: Any) -> ObservationBatch:
    """Observations of a source at one instant in a program, as a batch of its only space and session."""
    only: dict[str, Any] = {"space": "scene", "session": "0" * 16, "dim": positions.shape[1]}
    return ObservationBatch(source=source, seq=seq, unit=unit, positions=positions, **only, **others)
