"""Selects the bodies that explain the trajectories at least total cost (step 8): facility location."""

import numpy as np

from ..arrays import Bools, Floats
from .belief import past_evidence
from .costs import Costs
from .fits import Fitted
from .subset import Scene

STATIC = 0
"""Column of the static body, which is always open, at no price."""
# Price of a membership, in nats that it takes to say which trajectories they are.
_MEMBERSHIP = 1.5


def select(scene: Scene, fitted: list[Fitted], costs: Costs) -> tuple[list[int], Costs]:
    """Columns to open, and the costs of those.

    A trajectory of a moving body pays for its membership: among many trajectories with correlated noise
    some always move alike by chance. A trajectory of a hypothesis that is known to be separate pays for
    leaving it.
    """
    judged: Bools = scene.judged
    body = costs.body + past_evidence(scene, fitted, costs) + membership_prices(scene, fitted)
    chosen = cheapest_bodies(body[judged], costs.outlier[judged], costs.opening)
    return chosen, costs.of(chosen)


def cheapest_bodies(body: Floats, outlier: Floats, opening: Floats) -> list[int]:
    """Columns to open: adds the body that saves most, then drops those that it made superfluous, and so on.

    Every trajectory takes the cheapest open body, or is an outlier if that costs less. Costs float64 [N, K],
    [N] and [K].
    """
    chosen = [STATIC]
    paid = np.minimum(outlier, body[:, STATIC])
    while True:
        gain = np.maximum(paid[:, None] - body, 0).sum(0) - opening
        gain[chosen] = -np.inf
        best = int(np.argmax(gain))
        if not gain[best] > 0:
            return chosen
        chosen.append(best)
        while (extra := _superfluous(body[:, chosen], outlier, opening[chosen])) is not None:
            chosen.pop(extra)
        paid = np.minimum(outlier, body[:, chosen].min(1))


def membership_prices(scene: Scene, fitted: list[Fitted]) -> Floats:
    """Price of a membership in each body, [K]: the nats that it takes to encode its members.

    These are 1 + log(N / m) for m of N trajectories; the static body, without owners, has none.
    """
    counts = np.array([len(body.owners) for body in fitted], np.intp)
    nats = 1 + np.log(np.maximum(int(scene.judged.sum()) / np.maximum(counts, 1), 1.0))
    return np.where(counts > 0, _MEMBERSHIP * nats, 0.0)


def _superfluous(body: Floats, outlier: Floats, opening: Floats) -> int | None:
    """Which open body's closing saves most, if closing any of them saves something."""
    if len(opening) == 1:
        return None
    paid = np.column_stack([outlier, body])
    least = np.partition(paid, 1, axis=1)
    # Without its body a trajectory takes the next best.
    added_cost = np.bincount(paid.argmin(1), least[:, 1] - least[:, 0], len(opening) + 1)[1:]
    loss = added_cost - opening
    loss[STATIC] = np.inf
    worst = int(np.argmin(loss))
    return worst if loss[worst] < 0 else None
