"""Joints between the states of a pair: fixed, prismatic and revolute.

The models of Sturm, Stachniss and Burgard (2011), "A probabilistic framework for learning kinematic models of
articulated objects". Each predicts a state from its joint position q:

    fixed       R = R0,            p = p0
    prismatic   R = R0,            p = p0 + q u
    revolute    R = exp(q u) R0,   p = c + exp(q u) (p0 - c)
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..arrays import Floats
from .states import States, turned, turns_between

FixedKind = Literal["fixed", "prismatic", "revolute"]
FREE_PARAMETERS: dict[FixedKind, int] = {"fixed": 6, "prismatic": 8, "revolute": 9}


@dataclass(frozen=True)
class Model:
    """A joint of the parent, in the parent's axes.

    Attributes
    ----------
    kind
        Which one.
    R0, p0
        float64 [3, 3] and [3], the state at position 0.
    u, c
        float64 [3] each, axis, and a point on it; zero where the joint does not turn.
    """

    kind: FixedKind
    R0: Floats
    p0: Floats
    u: Floats
    c: Floats

    def predicted(self, q: Floats) -> tuple[Floats, Floats]:
        """Orientations [n, 3, 3] and places [n, 3] at positions [n]."""
        if self.kind == "revolute":
            R = turned(self.R0, q[:, None] * self.u)
            E = R @ self.R0.T
            return R, self.c + E @ (self.p0 - self.c)
        moved = self.p0 + q[:, None] * self.u if self.kind == "prismatic" else np.tile(self.p0, (len(q), 1))
        return np.tile(self.R0, (len(q), 1, 1)), moved

    def positions(self, states: States) -> Floats:
        """Position of each state on the joint, roughly, float64 [n]."""
        if self.kind == "prismatic":
            return np.asarray((states.p - self.p0) @ self.u)
        if self.kind == "revolute":
            return np.asarray(turns_between(states.R, self.R0) @ self.u)
        return np.zeros(len(states))
