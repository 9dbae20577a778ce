"""Counts by sequence numbers how many messages were lost before each, finds repeats, and follows epochs.

Every message with a `seq` counts 0, 1, 2 ... per publisher and session. A number that is skipped is a
lost message until it comes; a number that comes twice is a repeated one. A reader that joins late has lost
nothing, unless it counts from zero.
"""

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

# Bounds on what a hostile or broken publisher can make the counter remember.
MAX_SESSIONS = 4096
MAX_GAPS = 1024
MAX_JUMP = 2**32
"""A jump by more is no loss, but 50 days of messages at 1 kHz: the numbers begin anew."""

MAX_EPOCH_STEP = 1000
"""A larger step upwards is not followed: one wrong number would shut out every service to come."""
EPOCH_LASTS_S = 10.0
"""After this time without an update the number is forgotten."""

Order = Literal["newest", "overtaken", "repeated"]


class Sighting(NamedTuple):
    """What follows from one sequence number.

    `lost` is how many messages are missing more than before: the numbers skipped right before this one, or
    -1 where it was counted as lost itself. `order` is ``newest`` for a number beyond all before,
    ``overtaken`` for the first sight of an older one, and ``repeated`` for one seen before.
    """

    lost: int
    order: Order


@dataclass
class _Run:
    """Numbers up to `newest`; `gaps` are the ranges [start, stop) of those not seen, ascending.

    Numbers below `counted` were never counted as lost.
    """

    newest: int
    counted: int
    gaps: list[tuple[int, int]] = field(default_factory=list)

    def extend(self, count: int) -> int:
        lost = max(count - 1 - self.newest, 0)
        if lost:
            self.gaps.append((self.newest + 1, count))
            del self.gaps[:-MAX_GAPS]
            self.newest = count - 1
        return lost

    def sight(self, seq: int) -> Sighting:
        if seq > self.newest:
            lost = self.extend(seq)
            self.newest = seq
            return Sighting(lost, "newest")
        at = bisect_right(self.gaps, (seq, 2**64)) - 1
        if at < 0 or seq >= self.gaps[at][1]:
            return Sighting(0, "repeated")
        start, stop = self.gaps[at]
        self.gaps[at : at + 1] = [part for part in ((start, seq), (seq + 1, stop)) if part[0] < part[1]]
        # The oldest numbers are the least likely to come.
        del self.gaps[:-MAX_GAPS]
        return Sighting(-1 if seq >= self.counted else 0, "overtaken")


@dataclass
class SequenceCounter:
    """Follows the sequence numbers of any number of publishers.

    It remembers the 4096 sessions seen last, and of each the 1024 gaps noted last: an older number counts
    as repeated. After a jump by more than 2^32 a session begins anew, so that one wrong number does no harm.
    """

    from_zero: bool = False  # count the numbers before the first one as lost too
    # The one seen last at the end.
    _runs: dict[tuple[str, str], _Run] = field(default_factory=dict)

    def sight(self, publisher: str, session: str, seq: int) -> Sighting:
        """Take note of a number.

        A `publisher` is whatever tells the streams apart, the name of a source or a key; each of its sessions
        counts for itself; `seq` is 0 or more.
        """
        run = self._runs.get((publisher, session))
        if run is not None and abs(seq - run.newest) <= MAX_JUMP:
            sighting = run.sight(seq)
        else:
            unseen = [(0, seq)] if run is None and 0 < seq <= MAX_JUMP else []
            lost = seq if unseen and self.from_zero else 0
            run, sighting = _Run(seq, seq - lost, unseen), Sighting(lost, "newest")
        self._keep((publisher, session), run)
        return sighting

    def expect(self, publisher: str, session: str, count: int) -> int:
        """Take note that a publisher says it has sent the numbers 0 to count - 1; returns how many are lost.

        A number that comes after all is ``overtaken``, and lost no more. A claim beyond what a gap may be is
        not believed.
        """
        run = self._runs.get((publisher, session), _Run(-1, 0))
        if not count or abs(count - 1 - run.newest) > MAX_JUMP:
            return 0
        self._keep((publisher, session), run)
        return run.extend(count)

    def _keep(self, key: tuple[str, str], run: _Run) -> None:
        self._runs.pop(key, None)
        self._runs[key] = run
        if len(self._runs) > MAX_SESSIONS:
            del self._runs[next(iter(self._runs))]

    def newest(self, publisher: str, session: str) -> int | None:
        """Largest number since the session began; None where it is not known."""
        run = self._runs.get((publisher, session))
        return None if run is None else run.newest

    def forget(self, publisher: str, session: str) -> None:
        """Forget a session that is over; nothing happens where it is not known."""
        self._runs.pop((publisher, session), None)


class Epochs:
    """Follows the epoch of a scene upwards; `newest` is that of the last update that was accepted."""

    def __init__(self) -> None:
        self.newest = 0
        self._accepted_s = -float("inf")

    def allows(self, epoch: int, now_s: float) -> bool:
        """Whether an update of this epoch is to be accepted; `now_s` is on a monotonic clock."""
        return now_s - self._accepted_s > EPOCH_LASTS_S or 0 <= epoch - self.newest <= MAX_EPOCH_STEP

    def follow(self, epoch: int, now_s: float) -> None:
        """Take note of an update that is accepted."""
        self.newest, self._accepted_s = epoch, now_s
