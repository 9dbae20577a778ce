"""Shares time among sources by what they cost: a deficit round robin, by which spaces take turns too.

In each round the time that may be spent is shared evenly among the sources that have something to do. A
source that spends more than its share owes the rest: it waits until later shares have paid for it. Time that
others leave is shared among the sources that wait. New sources have one share together, so that no sender
gets more by taking new names; each owes for itself.

Without a clock nothing is measured, and every source may always go on: a recording, played as fast as it can
be, gives the same answer everywhere.
"""

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from statistics import median_low

CostClock = Callable[[], int]
"""Gives the time that has been spent, in ns from any start: processor time, or counted in a test."""

# A single pause of the machine, or something large that was due for all, must not mute a source for long:
# none owes more than its share of so many ns.
_MOST_DEBT_NS = 400_000_000
# ns; less than this is not shared any more.
_LEAST_REST_NS = 100_000
# Share of its time that a round has in any case, whatever else was spent.
_LEAST = 0.25
# Updates of a space whose costs are remembered: their median counts, as a single cost is no measure.
_REMEMBERED = 5
# A source that costs this share of what the costliest one costs is named beside it.
_AS_COSTLY = 0.5


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

    def rounds(
        self, at_ns: int, waiting: Callable[[], Collection[str]], new: Collection[str] = ()
    ) -> Iterator[None]:
        """Begin a round at a time on the clock of arrivals, and yield as long as any of it is left.

        It is shared among the sources that are `waiting`, of which some are `new`.
        """
        self._new, spenders = new, waiting()
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
        self._credit = {n: credit for n, credit in self._credit.items() if credit < 0 or n in spenders}
        while waiting():
            yield
            if self.clock is None or self._left < _LEAST_REST_NS:
                break
            self._share(waiting())

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
        left = self._credit.get(name, 0) > 0 and (name not in self._new or self._left_to_new > 0)
        return self.clock is None or left

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


@dataclass
class Turns:
    """Lets spaces be updated in turn, as far as the budget of their sources goes.

    `costly` are the sources for which spaces had to wait in the last round: what theirs cost is more than
    their share, and at least half as much as of the costliest one. Beside that one, on a machine with little
    time left, the share of sources that cost little may be too small as well.
    """

    budget: Budget
    costly: set[str] = field(default_factory=set)
    _round: int = 0
    # By space: in which round it was updated last, and what its last updates cost, ns.
    _updated: dict[str, int] = field(default_factory=dict)
    _costs: dict[str, deque[int]] = field(default_factory=dict)

    def take(
        self, at_ns: int, shares: Mapping[str, Mapping[str, float]], update: Callable[[str], None]
    ) -> list[str]:
        """Update some spaces, the one that has waited for longest first: one at least.

        `shares` has by name of a space the share of each source in what it costs; `update` updates one by its
        name. Returns the names of those that wait.
        """
        self._round += 1
        self._updated = {name: self._updated.get(name, 0) for name in shares}
        self._costs = {name: self._costs.get(name, deque(maxlen=_REMEMBERED)) for name in shares}
        waiting = sorted(shares, key=lambda name: (self._updated[name], name))
        for _ in self.budget.rounds(at_ns, lambda: set().union(*(shares[name] for name in waiting))):
            for name in list(waiting):
                is_first = len(waiting) == len(shares)
                if not is_first and not any(self.budget.allows(source) for source in shares[name]):
                    continue
                waiting.remove(name)
                with self.budget.charge(shares[name]):
                    update(name)
                self._updated[name] = self._round
                self._costs[name].append(self.budget.cost_ns)
        self.costly = self._costliest(shares) if waiting else set()
        return waiting

    def _costliest(self, shares: Mapping[str, Mapping[str, float]]) -> set[str]:
        """Sources whose spaces cost more than their share, and about as much as those of any other."""
        costs = {name: median_low(costs) for name, costs in self._costs.items() if costs}
        # A space that has not been updated yet costs as others do.
        usual_ns = median_low(costs.values())
        spent: Counter[str] = Counter()
        for name, parts in shares.items():
            cost_ns = costs.get(name, usual_ns)
            spent.update({source: round(part * cost_ns) for source, part in parts.items()})
        least = max(self.budget.share_ns, _AS_COSTLY * max(spent.values()))
        return {source for source, cost_ns in spent.items() if source and cost_ns >= least}
