"""Memory of the method from update to update: which hypotheses are separate bodies, and their clear members.

The window holds the evidence of its own frames alone: a body that rests for longer would become a part of
the static one, and the body of a feature that rests among resting bodies would be forgotten. So each
hypothesis has a record of how long it has clearly moved, and each trajectory a record of whether it has once
clearly been a member. Both hold until later evidence contradicts them.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Ints, Labels, Stamps, find
from ..geometry.frames import SETTLED, Frames
from ..partition import NO_HYPOTHESIS
from .assignment import SURE, SearchResult
from .costs import Costs, path_price
from .fits import Fitted
from .subset import Scene

# Gain of a body over rest, in prices of the body, from which on it clearly moves: noise that is correlated
# over time gains once or twice the price by chance.
_CLEARLY = 4.0
# nat; margin by which rest must explain the members better than the body does to count against the body.
_CONTRARY = 10.0
# Hypothesis of a trajectory without a clear membership; differs from every hypothesis and from NO_HYPOTHESIS.
_UNKNOWN = NO_HYPOTHESIS - 1


@dataclass
class Record:
    """Evidence so far that one hypothesis is a body of its own.

    It is known to be one after a second of motion that explains the members better than rest does by more
    than its price, until there has been evidence to the contrary for twice as long.

    Attributes
    ----------
    seconds, contrary
        Of clear motion, and of evidence since that it is no body of its own, s of event time.
    moves
        Whether it clearly moved at the last update.
    """

    seconds: float = 0.0
    contrary: float = 0.0
    moves: bool = False

    @property
    def separate(self) -> bool:
        """Whether it is known to be a body of its own."""
        return self.seconds >= SETTLED


class Belief:
    """Records of the hypotheses of one space, and the clear members of each by trajectory."""

    def __init__(self) -> None:
        self.records: dict[int, Record] = {}
        self._stamp_ns: int | None = None
        # Of all trajectories of the last update, keys ascending, and the hypothesis that each has clearly
        # been a member of.
        self._keys: Stamps = np.zeros(0, np.int64)
        self._member_of: Labels = np.zeros(0, np.int64)

    def learn(self, result: SearchResult, frames: Frames, ids: Labels) -> None:
        """Take in the result of an update, of which int64 [K] `ids` are the hypotheses of the bodies."""
        stamp_ns = int(frames.stamps[-1])
        step = 0.0 if self._stamp_ns is None else max((stamp_ns - self._stamp_ns) * 1e-9, 0.0)
        self._stamp_ns = stamp_ns
        evidence, labels, gains = result.evidence, result.assignment.labels, result.gains
        moves = gains[:, 0] > _CLEARLY * evidence.opening
        for k, hypothesis in enumerate(ids.tolist()):
            if hypothesis == NO_HYPOTHESIS or result.bodies[k].static or not (labels == k).any():
                continue
            record = self.records.setdefault(hypothesis, Record())
            # Rest explains the members better, or another body that clearly moves nearly as well.
            lost = gains[k].min(where=moves & (np.arange(len(ids)) != k), initial=np.inf)
            against = gains[k, 0] < -_CONTRARY or lost < evidence.opening[k]
            record.moves = bool(moves[k])
            record.seconds += step if moves[k] else 0.0
            record.contrary = record.contrary + step if against else 0.0
            if record.contrary > 2 * SETTLED:
                record.seconds = 0.0
        member_of = np.append(self._member_of, _UNKNOWN)[find(frames.key, self._keys)]
        clear = _clear(evidence, labels)
        clear[clear] = ids[labels[clear]] != NO_HYPOTHESIS
        member_of[clear] = ids[labels[clear]]
        self._keys, self._member_of = frames.key, member_of

    def scene(self, frames: Frames, newest: Floats, hypotheses: Labels, static: int | None) -> Scene:
        """The scene of an update, with the memory of its trajectories.

        Parameters
        ----------
        frames, newest, hypotheses
            Its rows; float64 [N, 3], newest positions; int64 [N], hypothesis of each trajectory.
        static
            Hypothesis that was the static one.
        """
        present = set(hypotheses.tolist())
        self.records = {h: record for h, record in self.records.items() if h in present}
        separate = [h for h, record in self.records.items() if record.separate]
        resting = [h for h in separate if not self.records[h].moves]
        index = find(frames.key, self._keys)
        return Scene(
            frames=frames,
            newest=newest,
            judged=frames.life >= frames.config.min_life,
            hypotheses=hypotheses,
            static=static,
            separate=np.isin(hypotheses, separate),
            resting=np.isin(hypotheses, resting),
            clear=np.append(self._member_of, _UNKNOWN)[index] == hypotheses,
        )

    def forget(self) -> None:
        """Forget the clear members: there are no trajectories."""
        self._keys, self._member_of = (np.zeros(0, np.int64) for _ in range(2))

    def state(self) -> dict[str, Any]:
        """What must survive a restart, as plain values and arrays."""
        return {
            "seconds": [[h, record.seconds] for h, record in self.records.items()],
            "keys": self._keys,
            "member_of": self._member_of,
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        self.records = {int(h): Record(seconds=float(seconds)) for h, seconds in state["seconds"]}
        self._keys, self._member_of = state["keys"], state["member_of"]


def carried_costs(scene: Scene, fitted: list[Fitted]) -> Floats:
    """What clear members pay for every body but those that continue their hypothesis, [N, K], nat."""
    cost, continued = np.zeros((len(scene.hypotheses), len(fitted))), continued_by(scene, fitted)
    for hypothesis in np.unique(scene.hypotheses[scene.clear]).tolist():
        members = scene.clear & (scene.hypotheses == hypothesis)
        cost[np.ix_(members, continued != hypothesis)] = SURE
    return cost


def past_evidence(scene: Scene, fitted: list[Fitted], costs: Costs) -> Floats:
    """Evidence from before the window against leaving a hypothesis, float64 [N, K], nat.

    The members of a hypothesis that is known to be separate have together what a body costs. They pay it
    for bodies under which they do not clearly move, as the static one, but not for those that continue it.
    """
    frames, hypotheses, current = scene.frames, scene.hypotheses, scene.judged & scene.frames.current
    evidence = np.zeros((len(hypotheses), len(fitted)))
    price = path_price(3 if frames.dim == 2 else 6, len(frames.stamps), frames.config.birth_price)
    continued = continued_by(scene, fitted)
    for hypothesis in np.unique(hypotheses[scene.separate]).tolist():
        members = hypotheses == hypothesis
        gain = (costs.body[members, :1] - costs.body[members]).sum(0)
        others = np.flatnonzero((gain <= _CLEARLY * costs.opening) & (continued != hypothesis))
        sharing = max(int((members & current).sum()), 1)
        evidence[np.ix_(members, others)] = price / sharing
    return evidence


def continued_by(scene: Scene, fitted: list[Fitted]) -> Labels:
    """Hypothesis that each body continues, int64 [K]; :data:`NO_HYPOTHESIS` for none.

    Most trajectories that a body was fitted to had it.
    """
    static = NO_HYPOTHESIS if scene.static is None else scene.static
    return np.array(
        [_usual(scene.hypotheses[body.owners]) if len(body.owners) else static for body in fitted],
        np.int64,
    )


def _usual(labels: Labels) -> int:
    """The hypothesis of more than half of labels int64 [m], m > 0."""
    # It is the median of the sorted labels.
    middle = len(labels) // 2
    median = int(np.partition(labels, middle)[middle])
    return median if 2 * np.count_nonzero(labels == median) > len(labels) else NO_HYPOTHESIS


def _clear(evidence: Costs, labels: Ints) -> Bools:
    """Which trajectories their body explains far better than any other does, bool [N]."""
    if evidence.body.shape[1] < 2:
        return np.zeros(len(labels), np.bool_)
    least = np.partition(evidence.body, 1, axis=1)
    return np.asarray((least[:, 1] - least[:, 0] > SURE) & (np.argmin(evidence.body, 1) == labels))
