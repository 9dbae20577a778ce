"""In states and a joint, out the joint that fits them best, by maximum likelihood.

Gauss-Newton on the whitened residuals (turn, place); the position of each state is eliminated. A state that
fits badly counts less (Student's t).
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..arrays import Floats
from .models import Model
from .states import States, skew, turned, turns_between

# Steps at most; of a kind that is hopeless, whose model goes on at the next judgement.
_STEPS, _FEW_STEPS = 8, 2

# Turn of R0, shift of p0, shift of c and turn of the axis, of the last two the parts across the axis.
_TURN, _SHIFT, _POINT, _AXIS = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 10)
_UNKNOWNS = 10
# Columns of derivatives beside: by the position, and what is left of the state.
_POSITION, _LEFT = _UNKNOWNS, _UNKNOWNS + 1
HEAVY = 30.0
"""Degrees of freedom of Student's t: residuals beyond some five standard deviations count less and less."""
# The step, in standard deviations squared, below which a fit has converged.
_SETTLED = 1e-2
# A direction below this squared length, in standard deviations per unit, does not determine a position.
_NO_DIRECTION = 1e-12
# What holds an unknown that nothing determines, as a share of the information on the others.
_HELD = 1e-9


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
        # Student's t: near half the square for small ones.
        return float((0.5 * HEAVY * np.log1p(self.squared / HEAVY)).sum()) + self.improbability


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


def joint_position(model: Model, state: States) -> float:
    """Position of one state on a joint, the best by its information; 0 if it is fixed."""
    return 0.0 if model.kind == "fixed" else float(_stepped(state, model, np.zeros(4), 0).q[0])


def _stepped(states: States, model: Model, prior: Floats, steps: int) -> Fit:
    """The fit after some steps at most.

    `prior` float64 [4] is where the point of a hinge is expected, and the inverse variance of that.
    """
    q = model.positions(states)
    for _ in range(steps):
        equations = _equations(states, model, q, prior)
        step = np.asarray(np.linalg.solve(equations.left, equations.right), np.float64)
        q = q + equations.slope[:, -1] - equations.slope[:, :-1] @ step
        model = _moved(model, step)
        # Where the joint does not fit, a standard deviation is more than the states say.
        if step @ equations.left @ step < _SETTLED * max(float(np.square(equations.residual).mean()), 1.0):
            break
    last = _equations(states, model, q, prior)
    # What is left along the joint is no residual.
    extra = last.slope[:, -1]
    squared = np.square(last.residual).sum(1) - extra**2 * last.strength
    sigma = np.sqrt(1 / last.strength) if model.kind != "fixed" else np.zeros(len(q))
    away = _across(model.u) @ (model.c - prior[:3]) if model.kind == "revolute" else np.zeros(2)
    improbability = float(0.5 * prior[3] * (away**2).sum())
    return Fit(model, q + extra, sigma, last.residual, squared, last.left, improbability)


class _Equations(NamedTuple):
    """Normal equations of a step: left [10, 10], right [10], float64 as all are.

    `residual` [n, 6], whitened; `strength` [n], information on each position; its step is of `slope` [n, 11]
    the last column less the product of the others with the step.
    """

    left: Floats
    right: Floats
    residual: Floats
    strength: Floats
    slope: Floats


def _across(u: Floats) -> Floats:
    """Two unit vectors across a unit vector, float64 [2, 3].

    Duff et al. (2017), "Building an orthonormal basis, revisited".
    """
    x, y, z = u.tolist()
    sign = 1.0 if z >= 0 else -1.0
    a = -1 / (sign + z)
    b = x * y * a
    return np.array([[1 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]])


def _equations(states: States, model: Model, q: Floats, prior: Floats) -> _Equations:
    white = states.roots @ _derivatives(states, model, q)
    residual = white[:, :, _LEFT].copy()
    along = white[:, :, _POSITION].copy()
    strength = np.square(along).sum(1) + _NO_DIRECTION
    share = np.einsum("ni,nik->nk", along, white) / strength[:, None]
    white -= along[:, :, None] * share[:, None]
    weight = 1 / (1 + np.square(residual).sum(1) / HEAVY)
    J = white[:, :, :_UNKNOWNS].reshape(-1, _UNKNOWNS)
    weighted = (J * np.repeat(weight, 6)[:, None]).T
    left, right = _constrained(model, weighted @ J, weighted @ white[:, :, _LEFT].ravel(), prior)
    return _Equations(left, right, residual, strength, share[:, [*range(_UNKNOWNS), _LEFT]])


def _derivatives(states: States, model: Model, q: Floats) -> Floats:
    """Derivatives of states by the unknowns and by the position, and what is left, float64 [n, 6, 12]."""
    J, u, sides = np.zeros((len(q), 6, _UNKNOWNS + 2)), model.u, _across(model.u).T
    R, p = model.predicted(q)
    E = R @ model.R0.T
    J[:, :3, _TURN] = J[:, 3:, _SHIFT] = E
    J[:, :3, _LEFT], J[:, 3:, _LEFT] = turns_between(states.R, R), states.p - p
    if model.kind == "prismatic":
        J[:, 3:, _POSITION] = u
        J[:, 3:, _AXIS] = -q[:, None, None] * (skew(u[None]) @ sides)
    elif model.kind == "revolute":
        arm = -skew(p - model.c)
        J[:, :3, _POSITION], J[:, 3:, _POSITION] = u, arm @ u
        J[:, :3, _AXIS] = J[:, 3:, _POINT] = sides - E @ sides
        J[:, 3:, _AXIS] = (E @ skew((model.p0 - model.c)[None]) + arm) @ sides
    return J


def _constrained(model: Model, left: Floats, right: Floats, prior: Floats) -> tuple[Floats, Floats]:
    """Hold what the kind does not have, and the position 0 along the joint."""
    scale = _HELD + float(np.trace(left)) / _UNKNOWNS
    lacking = {"fixed": [6, 7, 8, 9], "prismatic": [6, 7], "revolute": []}[model.kind]
    gauge = np.zeros(_UNKNOWNS)
    if model.kind == "prismatic":
        gauge[_SHIFT] = model.u
    elif model.kind == "revolute":
        gauge[_TURN], gauge[_SHIFT] = model.u, -skew((model.p0 - model.c)[None])[0] @ model.u
        # An axis that no turn determines stays where it is.
        left[[6, 7, 8, 9], [6, 7, 8, 9]] += [prior[3], prior[3], 1.0, 1.0]
        right[_POINT] += prior[3] * _across(model.u) @ (prior[:3] - model.c)
    left[lacking, lacking] += scale
    return left + scale * np.outer(gauge, gauge) + _HELD * scale * np.eye(_UNKNOWNS), right


def _moved(model: Model, step: Floats) -> Model:
    """A joint after a step of its unknowns."""
    R0, p0 = turned(model.R0, step[_TURN]), model.p0 + step[_SHIFT]
    if model.kind == "fixed":
        return replace(model, R0=R0, p0=p0)
    sides = _across(model.u)
    bend = step[_AXIS] @ sides
    # Beyond a radian the equations are not linear.
    bend /= max(1.0, float(np.linalg.norm(bend)))
    u = turned(model.u, bend)
    return replace(model, R0=R0, p0=p0, u=u, c=model.c + step[_POINT] @ sides)
