"""Choice of hypotheses as facility location: least total cost of trajectories and of opening bodies."""

import numpy as np

from ..arrays import Floats, Ints
from ..compiled import compiled
from .bodies import Costs

STATIC = 0
"""The first candidate is the static body: always open, at no price."""


def select(costs: Costs) -> list[int]:
    """Columns to open: greedy adding, and after each addition dropping what became superfluous.

    Every trajectory takes the cheapest open body, or its outlier cost.
    """
    body, outlier, opening = costs.body, costs.outlier, costs.opening
    chosen = [STATIC]
    paid = np.minimum(outlier, body[:, STATIC])
    while True:
        gain = np.maximum(paid[:, None] - body, 0).sum(0) - opening
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        if not gain[best] > 0:
            return chosen
        chosen.append(best)
        while (extra := _superfluous(costs, chosen)) is not None:
            chosen.remove(extra)
        paid = _paid(costs, chosen)


def _paid(costs: Costs, chosen: list[int]) -> Floats:
    return np.asarray(np.minimum(costs.outlier, costs.body[:, chosen].min(1)))


def _superfluous(costs: Costs, chosen: list[int]) -> int | None:
    """The open body whose closing saves most, if any does."""
    if len(chosen) == 1:
        return None
    loss = _regrets(costs.outlier, costs.body, np.array(chosen)) - costs.opening[chosen]
    loss[0] = np.inf
    worst = int(np.argmin(loss))
    return chosen[worst] if loss[worst] < 0 else None


@compiled()
def _regrets(outlier: Floats, body: Floats, chosen: Ints) -> Floats:
    """What the members of each open body, [K], would pay more if it were closed."""
    found = np.zeros(len(chosen))
    for i in range(len(outlier)):
        best, lowest, second = -1, outlier[i], np.inf
        for k in range(len(chosen)):
            cost = body[i, chosen[k]]
            if cost < lowest:
                best, lowest, second = k, cost, lowest
            elif cost < second:
                second = cost
        if best >= 0:
            found[best] += second - lowest
    return found
