"""A batch in, its rows grouped by acquisition time out; and the two events that event time gives out."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Instant:
    """Released rows of one batch that share one acquisition time.

    Attributes
    ----------
    stamp_ns
        Acquisition time, nanoseconds since the Unix epoch.
    batch
        The whole batch.
    rows
        intp [n], ascending: the rows of the batch that belong to this instant.
    session
        Number of the (source, session) that sent it.
    in_order
        False where the watermark had passed the stamp when the batch came.
    last
        Whether this is the newest instant of its batch.
    """

    stamp_ns: int
    batch: ObservationBatch
    rows: Indices
    session: int
    in_order: bool
    last: bool


@dataclass(frozen=True)
class SessionEnded:
    """A source has started a new session: the trajectories of session number `session` are over."""

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
