"""Fits joints to the states of a pair: fixed, prismatic and revolute, by maximum likelihood.

The models of Sturm, Stachniss and Burgard (2011), "A probabilistic framework for learning kinematic models of
articulated objects". Each predicts a state from its joint position q:

    fixed       R = R0,            p = p0
    prismatic   R = R0,            p = p0 + q u
    revolute    R = exp(q u) R0,   p = c + exp(q u) (p0 - c)

Gauss-Newton on the whitened residuals (turn, place); the position of each state is eliminated. A state that
fits badly counts less (Student's t).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..arrays import Floats
from .kernels import FIXED, HEAVY, PRISMATIC, REVOLUTE, UNKNOWNS, fit_joint
from .states import States, turned, turns_between

FixedKind = Literal["fixed", "prismatic", "revolute"]
# Gauss-Newton steps at most; of a kind that is hopeless, whose model goes on at the next judgement.
_STEPS, _FEW_STEPS = 8, 2
_NUMBERS: dict[FixedKind, int] = {"fixed": FIXED, "prismatic": PRISMATIC, "revolute": REVOLUTE}
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


@dataclass(frozen=True)
class Fit:
    """A model fitted to n states.

    Attributes
    ----------
    model
        The joint.
    q, q_sigma
        float64 [n], positions and their one-sigma; zero for a fixed joint.
    residual, squared
        float64 [n, 6], whitened residuals, and [n], their squares less what is along the joint.
    information
        float64 [10, 10] on (turn of R0, p0, c, axis); c and axis across the axis.
    improbability
        Minus the log prior of the model, without its constant.
    """

    model: Model
    q: Floats
    q_sigma: Floats
    residual: Floats
    squared: Floats
    information: Floats
    improbability: float

    @property
    def covariance(self) -> Floats:
        """Inverse of the information."""
        return np.asarray(np.linalg.inv(self.information), np.float64)

    @property
    def cost(self) -> float:
        """Minus the log posterior of the model, without its constant."""
        return float(_robust(self.squared).sum()) + self.improbability


def _robust(squared: Floats) -> Floats:
    """Minus the log density of Student's t, near half the square for small ones."""
    return np.asarray(0.5 * HEAVY * np.log1p(squared / HEAVY), np.float64)


def fit(states: States, start: Model, reach: float, *, hopeless: bool = False) -> Fit:
    """Fit a model from a start.

    Parameters
    ----------
    states
        n > 0 states.
    start
        Of the kind that is fitted.
    reach
        Standard deviation of the distance between the child and the axis of a hinge: a hinge that is far
        away is a slide.
    hopeless
        Whether its kind fitted by far too badly.
    """
    prior = np.append(states.p.mean(0), 1 / reach**2)
    return _stepped(states, start, prior, _FEW_STEPS if hopeless else _STEPS)


def _stepped(states: States, start: Model, prior: Floats, steps: int) -> Fit:
    """The fit after some steps at most."""
    R0, q = start.R0.copy(), positions(start, states)
    frame = np.vstack([start.p0, start.u, start.c, np.zeros((2, 3))])
    joint = _NUMBERS[start.kind], R0, frame, q, prior
    left, residual, strength, slope = fit_joint(states.R, states.p, states.roots, *joint, steps)
    model = replace(start, R0=R0, p0=frame[0], u=frame[1], c=frame[2])
    # What is left along the joint is no residual.
    extra = slope[:, UNKNOWNS]
    squared = np.asarray((residual**2).sum(1) - extra**2 * strength, np.float64)
    sigma = np.sqrt(1 / strength) if model.kind != "fixed" else np.zeros(len(q))
    away = frame[3:] @ (model.c - prior[:3]) if model.kind == "revolute" else np.zeros(2)
    improbability = float(0.5 * prior[3] * (away**2).sum())
    return Fit(model, q + extra, sigma, residual, squared, left, improbability)


def positions(model: Model, states: States) -> Floats:
    """Position of each state on a joint, roughly, float64 [n]."""
    if model.kind == "prismatic":
        return np.asarray((states.p - model.p0) @ model.u)
    if model.kind == "revolute":
        return np.asarray(turns_between(states.R, model.R0) @ model.u)
    return np.zeros(len(states))


def joint_position(model: Model, state: States) -> float:
    """Position of one state on a joint, the best by its information; 0 if it is fixed."""
    return 0.0 if model.kind == "fixed" else float(_stepped(state, model, np.zeros(4), 0).q[0])
