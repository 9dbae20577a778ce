"""In costs, out the bodies to open (step 8): facility location, the least cost of trajectories and bodies."""

import numpy as np

from ..arrays import Floats
from .costs import Costs
from .kernels.assignment import closing_losses

STATIC = 0
"""Column of the static body, which is always open, at no price."""


def select(costs: Costs) -> list[int]:
    """Columns to open: adds the body that saves most, then drops those that it made superfluous, and so on.

    Every trajectory takes the cheapest open body, or is an outlier if that costs less.
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
    """Cost of each trajectory with some bodies open, float64 [N]."""
    return np.asarray(np.minimum(costs.outlier, costs.body[:, chosen].min(1)))


def _superfluous(costs: Costs, chosen: list[int]) -> int | None:
    """Column of the open body whose closing saves most, if closing any of them saves something."""
    if len(chosen) == 1:
        return None
    loss = closing_losses(costs.outlier, costs.body, np.array(chosen)) - costs.opening[chosen]
    loss[0] = np.inf
    worst = int(np.argmin(loss))
    return chosen[worst] if loss[worst] < 0 else None
