"""States of a pair in, the few that stand for all that was seen: they outlive the window."""

from dataclasses import dataclass, field

import numpy as np

from ..arrays import Floats
from .states import States, turned, turns_between

# States within a cell are one key state: rad, and share of the child's radius.
_CELL_TURN = 0.04
_CELL_SHIFT = 0.1
# Key states of a pair.
_MAX_STATES = 40
# A key state is worth so many of its frames at most: errors that last do not average out.
_MAX_WEIGHT = 20.0


@dataclass
class KeyStates:
    """Some states of a pair, and float64 [n], how many each stands for."""

    states: States = field(default_factory=States.empty)
    weight: Floats = field(default_factory=lambda: np.zeros(0))

    def absorb(self, new: States, radius: float) -> None:
        """Take in states; `radius` is the child's, in the unit of the space."""
        cell = max(_CELL_SHIFT * radius, 1e-9)
        for k in range(len(new)):
            self._add(new.of(slice(k, k + 1)), cell)
            if len(self.weight) > _MAX_STATES:
                self._thin(cell)

    def _add(self, one: States, cell: float) -> None:
        distance = _distances(self.states, one, cell)[:, 0]
        if len(distance) and distance.min() < 1:
            self._fuse(int(distance.argmin()), one)
            return
        self.states = States.joined([self.states, one])
        self.weight = np.append(self.weight, 1.0)

    def _fuse(self, k: int, one: States) -> None:
        """Average a state into a key state."""
        states, count = self.states, float(self.weight[k])
        share = 1 / (min(count, _MAX_WEIGHT) + 1)
        states.R[k] = turned(states.R[k], share * turns_between(one.R, states.R[k])[0])
        states.p[k] += share * (one.p[0] - states.p[k])
        if count < _MAX_WEIGHT:
            states.information[k] += one.information[0]
        self.weight[k] = count + 1

    def _thin(self, cell: float) -> None:
        """Drop the key state that is nearest to another."""
        apart = _distances(self.states, self.states, cell)
        np.fill_diagonal(apart, np.inf)
        nearest = apart.min(1)
        kept = np.arange(len(nearest)) != nearest.argmin()
        self.states, self.weight = self.states.of(kept), self.weight[kept]


def _distances(states: States, others: States, cell: float) -> Floats:
    """Distances of states from others in cells, [n, m]."""
    # 3 - tr(R1 R2^T) = 2 (1 - cos): its root is the chord of the turn.
    trace = states.R.reshape(-1, 9) @ others.R.reshape(-1, 9).T
    shift = np.linalg.norm(states.p[:, None] - others.p, axis=2)
    return np.asarray(np.maximum(np.sqrt(np.maximum(3 - trace, 0)) / _CELL_TURN, shift / cell))
