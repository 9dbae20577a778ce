"""Shares the time for updating spaces, and the trajectories, among the sources."""

from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from statistics import median_low

from .event_time.budget import Budget
from .tracks import Tracks

# Updates of a space whose costs are remembered: their median counts, as a single cost is no measure.
_REMEMBERED = 5
# A source that costs this share of what the costliest one costs is named beside it.
_AS_COSTLY = 0.5


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
        self.budget.begin(at_ns, set().union(*shares.values()))
        any_updated = False
        while waiting:
            left_waiting = []
            for name in waiting:
                if any_updated and not any(self.budget.allows(source) for source in shares[name]):
                    left_waiting.append(name)
                    continue
                any_updated = True
                with self.budget.charge(shares[name]):
                    update(name)
                self._updated[name] = self._round
                self._costs[name].append(self.budget.cost_ns)
            waiting = left_waiting
            if not self.budget.share_rest({source for name in waiting for source in shares[name]}):
                break
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


def allowance(spaces: Collection[Tracks], most: int, session: int, wanted: int) -> int:
    """How many new trajectories a session may open of `most` in all; sessions above their share lose some."""
    free = max(most - sum(space.occupied() for space in spaces), 0)
    if wanted <= free:
        return wanted
    held: Counter[int] = Counter()
    for space in spaces:
        held.update(space.held())
    share = most // len(held.keys() | {session})
    due = min(wanted, share - held[session])
    while free < due:
        greediest = max(held, key=lambda number: held[number], default=session)
        excess = held[greediest] - share
        if greediest == session or excess <= 0:
            break
        freed, most_freed = 0, min(due - free, excess)
        for space in spaces:
            freed += space.displace(greediest, most_freed - freed)
        if not freed:
            break
        held[greediest] -= freed
        free += freed
    return min(wanted, free)
