"""Notices sources whose ids or unit cannot be right, for as long as their data shows it.

Three mistakes make data useless though each batch is well formed:

- `ids-short-lived`: a detector without a tracker numbers what it sees anew; nothing is seen twice.
- `ids-reused`: an id comes back after its end, or ids are places in a list, so that features trade them.
- `scale`: positions are hundreds of times farther out than those of others, or those of a lone source span
  more than metres usually do (:mod:`.extent_check`).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.doubts import trading

from .arrays import Floats
from .event_time.troubles import Troubles

Ids = NDArray[np.uint64]
Where = tuple[int, str]
"""Session number and space."""

# Counts fade by this share with every instant, and say something after so many instants.
_FADE = 0.02
_LEAST_INSTANTS = 20
# Mean number of instants in which an id is seen, below which motion can hardly be measured.
_LEAST_LIFE = 4.0
# Rows of an instant that are looked at.
MOST_ROWS = 512
# Times that an id came back after its end; a batch that was overtaken may bring one back.
_LEAST_RETURNS = 3
# Two instants are compared so often, or where a feature leaps, if they are not farther apart than the last.
_COMPARE_NS, _APART_NS = 250_000_000, 500_000_000
_LEAST_SHARED = 5
# Features that were where others had been, as a share of all: one exchange of many, or some of fewer.
_TRADED = 0.5


class Stored(NamedTuple):
    """What became of an instant: whether it `fits` into the scene, rows with new ids, and with ended ones.

    `factor` is how many times as far out it was as others see, 0: not far out; `doubt` says that all that its
    source sees looks as if it was in another unit.
    """

    fits: bool = True
    fresh: int = 0
    ended: int = 0
    factor: float = 0.0
    doubt: str = ""


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
    last: tuple[int, Ids, Floats] | None = None


class SourceChecks:
    """Follows the data of every session number, in each space that it publishes in.

    Parameters
    ----------
    troubles
        What is wrong is noted there, with a number that says how much: the instants that an id lasts, the
        share of features that jump (0: ended ids come back), how many times as far out as others see
        positions are, or what they look like.
    """

    def __init__(self, troubles: Troubles) -> None:
        self._troubles = troubles
        self._records: dict[Where, _Record] = {}

    def note(self, where: Where, source: str, stored: Stored) -> None:
        """Take note of what became of an instant of a source."""
        record = self._records.setdefault(where, _Record())
        if stored.factor or stored.doubt:
            self._troubles.note("scale", source, stored.factor or stored.doubt)
        if stored.ended:
            record.returns += 1
            if record.returns >= _LEAST_RETURNS:
                self._troubles.note("ids-reused", source, 0.0)

    def look(
        self, where: Where, source: str, ids: Ids, positions: Floats, fresh: float, stamp_ns: int
    ) -> None:
        """Look at the ids of an instant.

        Parameters
        ----------
        where, source
            Whose it is.
        ids, positions
            uint64 [n] and [n, dim], of some rows.
        fresh
            Share of the ids that are new.
        stamp_ns
            Its stamp.
        """
        if not len(ids):
            return
        record = self._records.setdefault(where, _Record())
        record.instants += 1
        record.rows = (1 - _FADE) * record.rows + len(ids)
        record.fresh = (1 - _FADE) * record.fresh + fresh * len(ids)
        if record.instants >= _LEAST_INSTANTS and record.fresh * _LEAST_LIFE > record.rows:
            self._troubles.note("ids-short-lived", source, record.rows / record.fresh)
        last, record.last = record.last, (stamp_ns, ids, positions)
        if last is None:
            return
        due = stamp_ns - record.compared_ns >= _COMPARE_NS
        if due or (np.array_equal(ids, last[1]) and _leaps(positions, last[2])):
            share = _traded(record, last, record.last)
            if share:
                self._troubles.note("ids-reused", source, share)

    def keep(self, sessions: set[int]) -> None:
        """Forget all sessions but some."""
        self._records = {where: one for where, one in self._records.items() if where[0] in sessions}


def _leaps(now: Floats, before: Floats) -> bool:
    """Whether any feature moves by a quarter of what all span; a cheap look at every instant."""
    return float(np.abs(now - before).max()) > 0.25 * float(np.ptp(now, axis=0).max())


def _traded(record: _Record, last: tuple[int, Ids, Floats], new: tuple[int, Ids, Floats]) -> float:
    """Compare two instants; the share of features that trade places of late, 0 while it says nothing."""
    (before_ns, known, places), (stamp_ns, ids, positions) = last, new
    _, mine, theirs = np.intersect1d(ids, known, return_indices=True)
    if len(mine) < _LEAST_SHARED or not 0 < stamp_ns - before_ns <= _APART_NS:
        return 0.0
    record.compared_ns = stamp_ns
    record.compared = 0.9 * record.compared + 1
    share = trading(places[theirs], positions[mine])
    record.jumped = 0.9 * record.jumped + share
    return record.jumped / record.compared if share and record.jumped > _TRADED else 0.0
