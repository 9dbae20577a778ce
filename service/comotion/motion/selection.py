"""Choice of hypotheses as facility location: least total cost of trajectories and of opening bodies."""

import numpy as np

from ..window import Floats
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
    table = np.column_stack([costs.outlier, costs.body[:, chosen]])
    first = np.argmin(table, 1)
    two = np.partition(table, 1, axis=1)
    regret = two[:, 1] - two[:, 0]
    loss = np.bincount(first, regret, len(chosen) + 1)[1:] - costs.opening[chosen]
    loss[0] = np.inf
    worst = int(np.argmin(loss))
    return chosen[worst] if loss[worst] < 0 else None
