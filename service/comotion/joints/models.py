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
from ..rigid.kernels.rotation import rotation_matrix
from .kernels import FIXED, PRISMATIC, REVOLUTE, UNKNOWNS, normal_equations
from .states import States, skew, turned, turns_between

FixedKind = Literal["fixed", "prismatic", "revolute"]
# Gauss-Newton steps at most, and the step, in standard deviations squared, below which it has converged.
_STEPS = 8
_SETTLED = 1e-2
# Degrees of freedom of Student's t: residuals beyond some five standard deviations count less and less.
HEAVY = 30.0
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
        float64 [3] each, axis, and a point on it (of a revolute joint).
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
    covariance
        float64 [10, 10] of the steps of (turn of R0, p0, c, axis); c and axis across the axis.
    improbability
        Minus the log prior of the model, without its constant.
    """

    model: Model
    q: Floats
    q_sigma: Floats
    residual: Floats
    squared: Floats
    covariance: Floats
    improbability: float

    @property
    def cost(self) -> float:
        """Minus the log posterior of the model, without its constant."""
        return float(_robust(self.squared).sum()) + self.improbability


def _robust(squared: Floats) -> Floats:
    """Minus the log density of Student's t, near half the square for small ones."""
    return np.asarray(0.5 * HEAVY * np.log1p(squared / HEAVY), np.float64)


def fit(states: States, start: Model, reach: float) -> Fit:
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
    """
    W = np.ascontiguousarray(np.linalg.cholesky(states.information).transpose(0, 2, 1))
    q, model, prior = positions(start, states), start, (states.p.mean(0), 1 / reach**2)
    for _ in range(_STEPS):
        system = _equations(states, W, model, q, prior)
        step = np.asarray(np.linalg.solve(system.left, system.right), np.float64)
        q = q + system.position_steps(step)
        model = _moved(model, step)
        # Where the joint does not fit, a standard deviation is more than the states say.
        if step @ system.left @ step < _SETTLED * max(float((system.residual**2).mean()), 1.0):
            break
    system = _equations(states, W, model, q, prior)
    # What is left along the joint is no residual.
    extra = system.slope[:, UNKNOWNS]
    squared = np.asarray((system.residual**2).sum(1) - extra**2 * system.strength, np.float64)
    sigma = np.sqrt(1 / system.strength) if model.kind != "fixed" else np.zeros(len(q))
    covariance = np.asarray(np.linalg.inv(system.left), np.float64)
    away = _across(model.u).T @ (model.c - prior[0]) if model.kind == "revolute" else np.zeros(2)
    return Fit(
        model, q + extra, sigma, system.residual, squared, covariance, float(0.5 * prior[1] * (away**2).sum())
    )


def positions(model: Model, states: States) -> Floats:
    """Position of each state on a joint, roughly, float64 [n]."""
    if model.kind == "prismatic":
        return np.asarray((states.p - model.p0) @ model.u)
    if model.kind == "revolute":
        return np.asarray(turns_between(states.R, model.R0) @ model.u)
    return np.zeros(len(states))


@dataclass(frozen=True)
class _System:
    """Normal equations of a step, positions eliminated, and what they step by."""

    left: Floats
    right: Floats
    residual: Floats
    strength: Floats
    slope: Floats

    def position_steps(self, step: Floats) -> Floats:
        """Steps of the positions that go with a step of the model, [n]."""
        return self.slope[:, UNKNOWNS] - self.slope[:, :UNKNOWNS] @ step


def _equations(states: States, W: Floats, model: Model, q: Floats, prior: tuple[Floats, float]) -> _System:
    n = len(q)
    left, right = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    residual, strength, slope = np.zeros((n, 6)), np.zeros(n), np.zeros((n, UNKNOWNS + 1))
    across = _across(model.u)
    # Of a joint that does not turn the point plays no part.
    point = model.c if model.kind == "revolute" else np.zeros(3)
    frame = np.vstack([model.p0, model.u, point, across.T])
    joint = _NUMBERS[model.kind], model.R0, frame, q, HEAVY
    normal_equations(states.R, states.p, W, *joint, left, right, residual, strength, slope)
    _constrain(left, right, model, across, prior)
    return _System(left, right, residual, strength, slope)


def _across(u: Floats) -> Floats:
    """Two unit vectors across an axis, [3, 2]."""
    x, y, z = u.tolist()
    # Duff et al. (2017), "Building an orthonormal basis, revisited".
    sign = 1.0 if z >= 0 else -1.0
    a = -1 / (sign + z)
    b = x * y * a
    return np.array([[1 + sign * x * x * a, b], [sign * b, sign + y * y * a], [-sign * x, -y]])


def _constrain(
    left: Floats, right: Floats, model: Model, across: Floats, prior: tuple[Floats, float]
) -> None:
    """Hold what the kind does not have, and the position 0 along the joint, in place."""
    scale = float(np.trace(left)) / 10 + 1e-9
    unused = {"fixed": range(6, 10), "prismatic": range(6, 8), "revolute": range(0)}[model.kind]
    for k in unused:
        left[k, k] += scale
    gauge = np.zeros(10)
    if model.kind == "prismatic":
        gauge[3:6] = model.u
    elif model.kind == "revolute":
        gauge[:3], gauge[3:6] = model.u, skew(model.u[None])[0] @ (model.p0 - model.c)
    left += scale * np.outer(gauge, gauge)
    left[range(10), range(10)] += 1e-9 * scale
    if model.kind == "revolute":
        centre, strength = prior
        left[6:8, 6:8] += strength * np.eye(2)
        right[6:8] += strength * across.T @ (centre - model.c)
        # An axis that no turn determines stays where it is.
        left[[8, 9], [8, 9]] += 1.0


def _moved(model: Model, step: Floats) -> Model:
    R0 = rotation_matrix(step[:3]) @ model.R0
    p0 = model.p0 + step[3:6]
    if model.kind == "fixed":
        return replace(model, R0=R0, p0=p0)
    across = _across(model.u)
    bend = across @ step[8:]
    length = float(np.linalg.norm(bend))
    # Beyond a radian the equations are not linear.
    u = rotation_matrix(bend * min(1.0, 1.0 / max(length, 1e-12))) @ model.u
    return replace(model, R0=R0, p0=p0, u=u, c=model.c + across @ step[6:8])


def joint_position(model: Model, state: States) -> float:
    """Position of one state on a joint, the best by its information; 0 if it is fixed."""
    q = positions(model, state)
    if model.kind == "fixed":
        return 0.0
    W = np.ascontiguousarray(np.linalg.cholesky(state.information).transpose(0, 2, 1))
    system = _equations(state, W, model, q, (model.c, 0.0))
    return float(q[0] + system.slope[0, UNKNOWNS])
