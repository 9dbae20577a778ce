"""Counts by sequence numbers how many messages were lost before each, and finds repeats.

Every message with a `seq` counts 0, 1, 2 ... per publisher and session. A number that is skipped is a
lost message until it comes; a number that comes twice is a repeated one. A reader that joins late has lost
nothing, unless it counts from zero.
"""

from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

# Bounds on what a hostile or broken publisher can make the counter remember.
MAX_SESSIONS = 4096
MAX_GAPS = 1024
MAX_RUNS = 4
MAX_JUMP = 2**32
"""A jump by more is no loss, but 50 days of messages at 1 kHz: it is counted apart."""

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

    @classmethod
    def begin(cls, seq: int, *, from_zero: bool) -> "_Run":
        oldest = max(seq - MAX_JUMP, 0)
        counted = 0 if from_zero and not oldest else seq
        return cls(seq, counted, [(oldest, seq)] if oldest < seq else [])

    def is_near(self, seq: int) -> bool:
        return abs(seq - self.newest) <= MAX_JUMP

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


class SequenceCounter:
    """Follows the sequence numbers of any number of publishers.

    It remembers the 4096 sessions seen last, and of each the 1024 gaps noted last: an older number counts
    as repeated. A jump by more than 2^32 is counted apart, so that one wrong number does no harm.

    Parameters
    ----------
    from_zero
        Count the numbers before the first one as lost too.
    """

    def __init__(self, *, from_zero: bool = False) -> None:
        self._from_zero = from_zero
        # Of each session the runs of its numbers, the one seen last at the end.
        self._sessions: dict[tuple[str, str], list[_Run]] = {}

    def sight(self, publisher: str, session: str, seq: int) -> Sighting:
        """Take note of a number.

        Parameters
        ----------
        publisher
            Whatever tells the streams apart: the name of a source, or a key.
        session
            Session of the publisher; each counts for itself.
        seq
            Sequence number, 0 or more.
        """
        runs = self._runs(publisher, session)
        run = next((known for known in reversed(runs) if known.is_near(seq)), None)
        if run is not None:
            if runs[-1] is not run:
                runs.remove(run)
                runs.append(run)
            return run.sight(seq)
        runs.append(_Run.begin(seq, from_zero=self._from_zero and not runs))
        del runs[:-MAX_RUNS]
        return Sighting(runs[-1].newest - runs[-1].counted if len(runs) == 1 else 0, "newest")

    def expect(self, publisher: str, session: str, count: int) -> int:
        """Take note that a publisher says it has sent the numbers 0 to count - 1; returns how many are lost.

        A number that comes after all is ``overtaken``, and lost no more. A claim beyond what a gap may be is
        not believed.
        """
        runs = self._sessions.get((publisher, session))
        if not count or count > 2**63 or (runs and not runs[-1].is_near(count - 1)):
            return 0
        if runs:
            return runs[-1].extend(count)
        if count > MAX_JUMP:
            return 0
        self._runs(publisher, session).append(_Run(count - 1, 0, [(0, count)]))
        return count

    def _runs(self, publisher: str, session: str) -> list[_Run]:
        """Runs of a session, which is now the one seen last: the last in the dictionary."""
        runs = self._sessions[publisher, session] = self._sessions.pop((publisher, session), [])
        if len(self._sessions) > MAX_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        return runs

    def newest(self, publisher: str, session: str) -> int | None:
        """Largest number of the run seen last; None where the session is not known."""
        runs = self._sessions.get((publisher, session))
        return runs[-1].newest if runs else None

    def forget(self, publisher: str, session: str) -> None:
        """Forget a session that is over; nothing happens where it is not known."""
        self._sessions.pop((publisher, session), None)

    def state(self) -> list[Any]:
        """As plain values."""
        return [
            [*key, [[run.newest, run.counted, [list(gap) for gap in run.gaps]] for run in runs]]
            for key, runs in self._sessions.items()
        ]

    def load(self, state: Iterable[Any]) -> None:
        """Take up :meth:`state`.

        Raises
        ------
        TypeError, ValueError
            If it is none.
        """
        self._sessions = {
            (str(publisher), str(session)): [
                _Run(int(newest), int(counted), [(int(start), int(stop)) for start, stop in gaps])
                for newest, counted, gaps in runs
            ]
            for publisher, session, runs in state
        }
