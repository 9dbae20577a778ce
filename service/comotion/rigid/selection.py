"""In costs, out the bodies to open (step 8): facility location, the least cost of trajectories and bodies."""

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..config import RigidConfig
from .belief import past_evidence
from .costs import Costs
from .subset import Scene

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


def weighted(scene: Scene, owners: list[Ints], found: Costs, config: RigidConfig) -> Costs:
    """Costs of the trajectories that count in the selection.

    A trajectory of a moving body pays for its membership: among many trajectories with correlated noise
    some always move alike by chance. A trajectory of a hypothesis that is known to be separate pays for
    leaving it. `owners` are the trajectories that each body was fitted to.
    """
    judged: Bools = scene.judged
    body = found.body + past_evidence(scene, owners, found, config) + membership_prices(scene, owners, config)
    return Costs(body[judged], found.outlier[judged], found.opening)


def supported(scene: Scene, owners: list[Ints], found: Costs, config: RigidConfig) -> list[int]:
    """Columns of the static body and of the bodies that the trajectories pay for that they were fitted to.

    Among very many at rest some, with more noise than is known, would gain by any body.
    """
    prices = membership_prices(scene, owners, config)
    gains = [
        float((found.body[own, STATIC] - found.body[own, k] - prices[k]).sum())
        for k, own in enumerate(owners)
    ]
    return [k for k, gain in enumerate(gains) if k == STATIC or gain > found.opening[k]]


def membership_prices(scene: Scene, owners: list[Ints], config: RigidConfig) -> Floats:
    """Price of a membership in each body, [K]: that of the nats that it takes to say which they are.

    These are 1 + log(N / m) for m of N trajectories; the static body, without owners, has none.
    """
    counts = np.array([len(own) for own in owners], np.intp)
    nats = 1 + np.log(np.maximum(int(scene.judged.sum()) / np.maximum(counts, 1), 1.0))
    return np.where(counts > 0, config.membership_price * nats, 0.0)


def _paid(costs: Costs, chosen: list[int]) -> Floats:
    """Cost of each trajectory with some bodies open, float64 [N]."""
    return np.asarray(np.minimum(costs.outlier, costs.body[:, chosen].min(1)))


def _superfluous(costs: Costs, chosen: list[int]) -> int | None:
    """Column of the open body whose closing saves most, if closing any of them saves something."""
    if len(chosen) == 1:
        return None
    paid = np.column_stack([costs.outlier, costs.body[:, chosen]])
    least = np.partition(paid, 1, axis=1)
    # Without its body a trajectory takes the next best.
    more = np.bincount(paid.argmin(1), least[:, 1] - least[:, 0], len(chosen) + 1)[1:]
    loss = more - costs.opening[chosen]
    loss[0] = np.inf
    worst = int(np.argmin(loss))
    return chosen[worst] if loss[worst] < 0 else None
