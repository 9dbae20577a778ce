"""Shares time among sources by what they cost: a deficit round robin.

In each round the time that may be spent is shared evenly among the sources that have something to do. A
source that spends more than its share owes the rest: it waits until later shares have paid for it. Time that
others leave is shared among the sources that wait. New sources have one share together, so that no sender
gets more by taking new names; each owes for itself.

Without a clock nothing is measured, and every source may always go on: a recording, played as fast as it can
be, gives the same answer everywhere.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf

CostClock = Callable[[], int]
"""Gives the time that has been spent, in ns from any start: processor time, or counted in a test."""

# A single pause of the machine, or something large that was due for all, must not mute a source for long:
# none owes more than its share of so many ns.
_MOST_DEBT_NS = 400_000_000
# ns; less than this is not shared any more.
_LEAST_REST_NS = 100_000
# Share of its time that a round has in any case, whatever else was spent.
_LEAST = 0.25


@dataclass
class Budget:
    """Time that may be spent in a period, by name of the source."""

    share: float
    """Share of time that may be spent."""
    period_ns: int
    """The time for which at most a round may make up, ns."""
    clock: CostClock | None = None
    """Measures costs; None: nothing is limited."""
    whole: float = inf
    """Share of time that may be spent with all else that the clock has measured since the last round."""
    share_ns: int = 0
    """Share of each source in a round like this if nothing else takes time, ns."""
    cost_ns: int = 0
    """The last charge, ns."""
    _credit: dict[str, int] = field(default_factory=dict)
    _new: Collection[str] = ()
    _left_to_new: int = 0
    _parties: int = 1
    _left: int = 0
    _at_ns: int | None = None
    # Reading of the clock at the end of the last charge.
    _clock_ns: int | None = None

    def begin(self, at_ns: int, spenders: Collection[str], new: Collection[str] = ()) -> None:
        """Begin a round at a time on the clock of arrivals; `spenders` have work, of which some are `new`."""
        self._new = new
        elapsed = self.period_ns if self._at_ns is None else at_ns - self._at_ns
        self._at_ns = at_ns
        most = min(max(elapsed, 0), self.period_ns)
        share = self.share
        if self.clock is not None and self._clock_ns is not None:
            beside = (self.clock() - self._clock_ns) / max(elapsed, 1)
            share = min(share, max(self.whole - beside, _LEAST * share))
        self._left = round(share * most)
        self._share(spenders)
        self.share_ns = round(self.share * most) // self._parties
        # A source without work saves no time for later.
        self._credit = {
            name: credit for name, credit in self._credit.items() if credit < 0 or name in spenders
        }

    def share_rest(self, spenders: Collection[str]) -> bool:
        """Share the rest of the round among some sources; whether there was any."""
        if self.clock is None or self._left < _LEAST_REST_NS:
            return False
        self._share(spenders)
        return True

    def _share(self, spenders: Collection[str]) -> None:
        new = sum(name in self._new for name in spenders)
        self._parties = max(len(spenders) - new + min(new, 1), 1)
        self._left_to_new = self._left // self._parties
        for name in {*spenders, *self._credit}:
            credit, quantum = self._credit.get(name, 0), self._left_to_new
            quantum //= new if name in self._new and new else 1
            self._credit[name] = min(credit + quantum, quantum)
            # The part of a share that pays a debt has been spent already.
            self._left -= min(max(-credit, 0), quantum) if name in spenders else 0

    def allows(self, name: str) -> bool:
        """Whether a source may go on."""
        if self.clock is None:
            return True
        return self._credit.get(name, 0) > 0 and (name not in self._new or self._left_to_new > 0)

    @contextmanager
    def charge(self, shares: Mapping[str, float]) -> Iterator[None]:
        """Charge sources with the cost of a block, each with its share of it."""
        if self.clock is None:
            yield
            return
        began = self.clock()
        try:
            yield
        finally:
            self._clock_ns = self.clock()
            self.cost_ns = cost = self._clock_ns - began
            self._left -= cost
            least = -round(self.share * _MOST_DEBT_NS / self._parties)
            for name, share in shares.items():
                self._credit[name] = max(self._credit.get(name, 0) - round(share * cost), least)
                self._left_to_new -= round(share * cost) if name in self._new else 0
