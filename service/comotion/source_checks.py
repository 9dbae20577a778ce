"""Notices sources whose ids or unit cannot be right, for as long as their data shows it.

Three mistakes make data useless though each batch is well formed:

- `ids-short-lived`: a detector without a tracker numbers what it sees anew; nothing is seen twice.
- `ids-reused`: an id comes back after its end, or ids are places in a list, so that features trade them.
- `scale`: positions are hundreds of times farther out than those of others, or those of a lone source span
  more than metres usually do (:mod:`.extent_check`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.doubts import trading

from .arrays import Floats
from .event_time.entries import Instants
from .event_time.troubles import Troubles

Ids = NDArray[np.uint64]
Seen = tuple[int, Ids, Floats]
"""Stamp, ids and positions float64 [n, dim] of an instant."""

# Counts fade by this share with every instant, and say something after so many instants.
_FADE = 0.02
_LEAST_INSTANTS = 20
# Mean number of instants in which an id is seen, below which motion can hardly be measured.
_LEAST_LIFE = 4.0
# Rows of an instant that are looked at.
_MOST_ROWS = 512
# Times that an id came back after its end; a batch that was overtaken may bring one back.
_LEAST_RETURNS = 3
# Two instants are compared so often, or where a feature leaps, if they are not farther apart than the last.
_COMPARE_NS, _APART_NS = 250_000_000, 500_000_000
_LEAST_SHARED = 5
# Features that were where others had been, as a share of all: one exchange of many, or some of fewer.
_TRADED = 0.5


@dataclass
class _Record:
    """What one session has sent: counts that fade, and the last instant that another is compared with."""

    instants: int = 0
    rows: float = 0.0
    fresh: float = 0.0
    returns: int = 0
    compared: float = 0.0
    jumped: float = 0.0
    compared_ns: int = -(2**62)
    last: Seen | None = None


class SourceChecks:
    """Follows the ids of every session number in a space.

    Troubles are noted with a number that says how much: the instants that an id lasts, or the share of
    features that jump (0: ended ids come back).
    """

    def __init__(self, troubles: Troubles) -> None:
        self._troubles = troubles
        self._records: dict[int, _Record] = {}

    def look(self, instants: Instants, fresh: int, ended: int) -> None:
        """Look at instants, of which so many rows were new and so many had an id that has ended."""
        source, rows = instants.batch.source, instants.rows[:_MOST_ROWS]
        record = self._records.setdefault(instants.session, _Record())
        record.returns += ended > 0
        if ended and record.returns >= _LEAST_RETURNS:
            self._troubles.note("ids-reused", source, 0.0)
        if len(rows):
            ids, positions = instants.batch.ids[rows], instants.batch.positions[rows].astype(np.float64)
            self._compare(record, source, fresh / len(instants.rows), (instants.stamp_ns, ids, positions))

    def _compare(self, record: _Record, source: str, fresh: float, seen: Seen) -> None:
        """Compare an instant, of whose ids a share is new, with those before."""
        stamp_ns, ids, positions = seen
        record.instants += 1
        record.rows = (1 - _FADE) * record.rows + len(ids)
        record.fresh = (1 - _FADE) * record.fresh + fresh * len(ids)
        if record.instants >= _LEAST_INSTANTS and record.fresh * _LEAST_LIFE > record.rows:
            self._troubles.note("ids-short-lived", source, record.rows / record.fresh)
        last, record.last = record.last, seen
        if last is None:
            return
        due = stamp_ns - record.compared_ns >= _COMPARE_NS
        if due or (np.array_equal(ids, last[1]) and _leaps(positions, last[2])):
            share = _traded(record, last, seen)
            if share:
                self._troubles.note("ids-reused", source, share)

    def keep(self, sessions: set[int]) -> None:
        """Forget all sessions but these, by number."""
        self._records = {number: record for number, record in self._records.items() if number in sessions}


def _leaps(positions: Floats, previous: Floats) -> bool:
    """Whether any feature moves by a quarter of what all span; a cheap look at every instant."""
    return float(np.abs(positions - previous).max()) > 0.25 * float(np.ptp(positions, axis=0).max())


def _traded(record: _Record, last: Seen, new: Seen) -> float:
    """Compare two instants; the share of features that trade places of late, 0 while it says nothing."""
    (previous_ns, previous_ids, previous_positions), (stamp_ns, ids, positions) = last, new
    _, rows, previous_rows = np.intersect1d(ids, previous_ids, return_indices=True)
    if len(rows) < _LEAST_SHARED or not 0 < stamp_ns - previous_ns <= _APART_NS:
        return 0.0
    record.compared_ns = stamp_ns
    record.compared = 0.9 * record.compared + 1
    share = trading(previous_positions[previous_rows], positions[rows])
    record.jumped = 0.9 * record.jumped + share
    return record.jumped / record.compared if share and record.jumped > _TRADED else 0.0
