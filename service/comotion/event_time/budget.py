"""Shares time among sources by what they cost: a deficit round robin.

In each round the time that may be spent is shared evenly among those who have something to do. Who spends
more than its share owes the rest: it waits until later shares have paid for it. What others leave of theirs
is shared among those who wait.

Without a clock nothing is measured, and everyone may always go on: a recording, played as fast as it can be,
gives the same answer everywhere.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

CostClock = Callable[[], int]
"""Gives the time that has been spent, in ns from any start: processor time, or counted in a test."""

# A single pause of the machine must not mute anybody for long: nobody owes more than so many rounds.
_MOST_DEBT = 4
# ns; less than this is not shared any more.
_LEAST_REST_NS = 100_000


@dataclass
class Budget:
    """Time that may be spent in a period, by name of the spender.

    Attributes
    ----------
    share
        Share of time that may be spent.
    period_ns
        The time for which at most a round may make up, ns.
    clock
        Measures costs; None: nothing is limited.
    """

    share: float
    period_ns: int
    clock: CostClock | None = None
    _credit: dict[str, int] = field(default_factory=dict)
    _left: int = 0
    _at_ns: int | None = None

    def begin(self, at_ns: int, spenders: Collection[str]) -> None:
        """Begin a round at a time on the clock of arrivals, in which some have something to do."""
        elapsed = self.period_ns if self._at_ns is None else at_ns - self._at_ns
        self._at_ns = at_ns
        self._left = round(self.share * min(max(elapsed, 0), self.period_ns))
        self._share(spenders)
        # Who has nothing to do saves nothing.
        self._credit = {name: one for name, one in self._credit.items() if one < 0 or name in spenders}

    def share_rest(self, spenders: Collection[str]) -> bool:
        """Share what is left of the round among some; whether there was anything."""
        if self.clock is None or self._left < _LEAST_REST_NS:
            return False
        self._share(spenders)
        return True

    def _share(self, spenders: Collection[str]) -> None:
        quantum = self._left // max(len(spenders), 1)
        for name in {*spenders, *self._credit}:
            before = self._credit.get(name, 0)
            self._credit[name] = min(before + quantum, quantum)
            # What pays a debt has been spent already.
            self._left -= min(max(-before, 0), quantum) if name in spenders else 0

    def allows(self, name: str) -> bool:
        """Whether somebody may go on."""
        return self.clock is None or self._credit.get(name, 0) > 0

    @contextmanager
    def charge(self, shares: Mapping[str, float]) -> Iterator[None]:
        """Charge some with what a block costs, each with its share of it."""
        if self.clock is None:
            yield
            return
        began = self.clock()
        try:
            yield
        finally:
            cost = self.clock() - began
            self._left -= cost
            least = -round(_MOST_DEBT * self.share * self.period_ns)
            for name, share in shares.items():
                self._credit[name] = max(self._credit.get(name, 0) - round(share * cost), least)
