"""In the evidence of updates, out which hypotheses are known to be bodies of their own, also at rest.

The costs know no motion that has left the window: a body that rests longer would become a part of the
static one. So this keeps whether a hypothesis has once clearly moved, and whether anything since contradicts
that it is a body of its own.
"""

from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels
from ..config import RigidConfig
from ..partition import NO_HYPOTHESIS
from .assignment import SearchResult
from .costs import Costs, pose_costs
from .subset import Scene

# s of motion that explains the members better than rest does by more than its price, until a hypothesis is
# known to be separate; and s of evidence to the contrary, until it no longer is.
_SEPARATE_AFTER, _FORGET_AFTER = 1.0, 2.0
# Gain of a body over rest, in prices of the body, from which on it clearly moves: noise that is correlated
# over time gains once or twice the price by chance.
_CLEARLY = 4.0
# The past pays a little more than what the body and its memberships cost.
_PAST_FACTOR = 1.2
# Share of the rows of a candidate that must be of one hypothesis for the candidate to continue it.
_PURE = 0.8
# nat; by so much rest must explain the members better than the body does to speak against it.
_CONTRARY = 10.0


class Separation:
    """Hypotheses that have moved on their own, and for how long, in s of event time."""

    def __init__(self) -> None:
        self._seconds: dict[int, float] = {}
        self._contrary: dict[int, float] = {}
        self._moving: set[int] = set()
        self._stamp_ns: int | None = None

    def learn(self, result: SearchResult, ids: Labels, stamp_ns: int) -> None:
        """Take in the result of an update.

        Parameters
        ----------
        result
            Its bodies and costs.
        ids
            int64 [K], the hypotheses of the bodies.
        stamp_ns
            Its event time.
        """
        step = 0.0 if self._stamp_ns is None else max((stamp_ns - self._stamp_ns) * 1e-9, 0.0)
        self._stamp_ns = stamp_ns
        evidence, labels = result.evidence, result.assignment.labels
        clear = [_gain(evidence, labels == k, k) > _CLEARLY * evidence.restless[k] for k in range(len(ids))]
        self._moving = {one for one, moves in zip(ids.tolist(), clear, strict=True) if moves}
        for k, one in enumerate(ids.tolist()):
            members = labels == k
            if one == NO_HYPOTHESIS or result.bodies[k].static or not members.any():
                continue
            if clear[k]:
                self._seconds[one] = self._seconds.get(one, 0.0) + step
            against = _contradicted(evidence, members, k, clear)
            self._contrary[one] = self._contrary.get(one, 0.0) + step if against else 0.0
            if self._contrary[one] > _FORGET_AFTER:
                self._seconds.pop(one, None)

    def known(self, before: Labels) -> Bools:
        """Whether the hypothesis of each trajectory, int64 [N], is known to be separate, bool [N]."""
        separate = [one for one, seconds in self._seconds.items() if seconds >= _SEPARATE_AFTER]
        return np.isin(before, separate)

    def resting(self, before: Labels) -> Bools:
        """Likewise, whether it did not clearly move at the last update either."""
        return self.known(before) & ~np.isin(before, list(self._moving))

    def keep(self, present: Labels) -> None:
        """Forget all hypotheses but those that are present, int64 [n]."""
        kept = set(present.tolist())
        self._seconds = {one: s for one, s in self._seconds.items() if one in kept}
        self._contrary = {one: s for one, s in self._contrary.items() if one in kept}

    def state(self) -> list[list[Any]]:
        """As plain values."""
        return [[one, seconds] for one, seconds in self._seconds.items()]

    def load(self, state: list[list[Any]]) -> None:
        """Take up :meth:`state`."""
        self._seconds = {int(one): float(seconds) for one, seconds in state}


def _gain(evidence: Costs, members: Bools, k: int) -> float:
    """By how much members bool [N] are cheaper under a body than at rest, nat."""
    return float((evidence.body[members, 0] - evidence.body[members, k]).sum())


def _contradicted(evidence: Costs, members: Bools, k: int, clear: list[bool]) -> bool:
    """Whether rest explains the members better, or another body that clearly moves nearly as well."""
    if _gain(evidence, members, k) < -_CONTRARY:
        return True
    others = [j for j, moves in enumerate(clear) if moves and j not in (0, k)]
    lost = [float((evidence.body[members, j] - evidence.body[members, k]).sum()) for j in others]
    return bool(min(lost, default=np.inf) < evidence.restless[k])


def past_evidence(scene: Scene, owners: list[Ints], found: Costs, config: RigidConfig) -> Floats:
    """Evidence from before the window against leaving a hypothesis, float64 [N, K], nat.

    The members of a hypothesis that is known to be separate have together what a body costs. They pay it
    for bodies under which they do not clearly move, as the static one, but not for those that continue it.
    `owners` are the trajectories that each of the K bodies was fitted to.
    """
    before, current = scene.before, scene.judged & scene.frames.current
    evidence = np.zeros((len(before), len(owners)))
    dof = 3 if scene.frames.dim == 2 else 6
    price = pose_costs(dof, len(scene.frames.stamps), config) + config.birth_price
    continued = continued_by(scene, owners)
    for one in np.unique(before[scene.separate]).tolist():
        members = before == one
        gain = (found.body[members, :1] - found.body[members]).sum(0)
        others = np.flatnonzero((gain <= _CLEARLY * found.restless) & (continued != one))
        sharing = max(int((members & current).sum()), 1)
        evidence[np.ix_(members, others)] = _PAST_FACTOR * price / sharing
    return evidence


def continued_by(scene: Scene, owners: list[Ints]) -> Labels:
    """Hypothesis that each body continues, int64 [K]; :data:`NO_HYPOTHESIS` for none.

    Nearly all trajectories that a body was fitted to had it. `owners` intp [m] each are these trajectories;
    none for the static body.
    """
    static = NO_HYPOTHESIS if scene.static is None else scene.static
    return np.array([_usual(scene.before[own]) if len(own) else static for own in owners], np.int64)


def _usual(labels: Labels) -> int:
    """The hypothesis of nearly all of labels int64 [m], m > 0."""
    # What more than half of them have is in the middle when they are sorted.
    middle = len(labels) // 2
    one = int(np.partition(labels, middle)[middle])
    return one if np.count_nonzero(labels == one) / len(labels) >= _PURE else NO_HYPOTHESIS
