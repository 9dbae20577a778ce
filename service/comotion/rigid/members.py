"""In the costs of updates, out which trajectories have clearly been members of their hypotheses.

What motion has said of a single trajectory leaves the window, as all motion does. Of a feature that rests
among resting bodies nothing would be known any more. So this keeps whether it has once clearly been a member.
"""

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels, Stamps, find
from ..partition import NO_HYPOTHESIS
from .assignment import SearchResult
from .memory import continued_by
from .subset import Scene

# nat; by so much a hypothesis must explain a trajectory better than any other to be sure, and what the
# trajectory then pays for leaving it: less, since a hypothesis may change. Chosen on stress scenes of even
# seeds and on the markers.
_SURE = 40.0
_LEAVING = 20.0
# Stands for the hypothesis of a trajectory that is not known; no hypothesis and no lack of one is this.
_UNKNOWN = NO_HYPOTHESIS - 1


class ClearMembers:
    """Trajectories, by key, and the hypothesis that each has clearly been a member of."""

    def __init__(self) -> None:
        # Keys ascending.
        self._keys: Stamps = np.zeros(0, np.int64)
        self._hypotheses: Labels = np.zeros(0, np.int64)

    def learn(self, result: SearchResult, keys: Stamps, ids: Labels) -> None:
        """Take in the result of an update.

        Parameters
        ----------
        keys, ids
            int64 [N], keys of its trajectories, and [K], hypotheses of its bodies.
        """
        cost, labels = result.evidence.body, result.assignment.labels
        if cost.shape[1] < 2:
            return
        least = np.partition(cost, 1, axis=1)
        clear = (least[:, 1] - least[:, 0] > _SURE) & (np.argmin(cost, 1) == labels)
        clear[clear] = ids[labels[clear]] != NO_HYPOTHESIS
        others = ~np.isin(self._keys, keys[clear])
        found = np.append(self._keys[others], keys[clear])
        order = np.argsort(found)
        self._keys = found[order]
        self._hypotheses = np.append(self._hypotheses[others], ids[labels[clear]])[order]

    def known(self, keys: Stamps, before: Labels) -> Bools:
        """Whether each trajectory has clearly been a member of the hypothesis that it has, bool [N].

        `keys` and `before` int64 [N] are of all trajectories there are; others are forgotten.
        """
        present = np.isin(self._keys, keys)
        self._keys, self._hypotheses = self._keys[present], self._hypotheses[present]
        known = np.append(self._hypotheses, _UNKNOWN)[find(keys, self._keys)]
        return np.asarray(known == before)

    def state(self) -> list[list[int]]:
        """As plain values."""
        return [[key, one] for key, one in zip(self._keys.tolist(), self._hypotheses.tolist(), strict=True)]

    def load(self, state: list[list[int]]) -> None:
        """Take up :meth:`state`."""
        self._keys, self._hypotheses = np.array(state, np.int64).reshape(-1, 2).T


def leaving_costs(scene: Scene, owners: list[Ints]) -> Floats:
    """What clear members pay for every body but those that continue their hypothesis, [N, K], nat.

    `owners` are the trajectories that each of the K bodies was fitted to; none for the static one.
    """
    cost, continued = np.zeros((len(scene.before), len(owners))), continued_by(scene, owners)
    for one in np.unique(scene.before[scene.clear]).tolist():
        members = scene.clear & (scene.before == one)
        cost[np.ix_(members, continued != one)] = _LEAVING
    return cost
