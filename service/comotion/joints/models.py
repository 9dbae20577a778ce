"""Joints between the states of a pair, and the one of a kind that fits them best.

The models of Sturm, Stachniss and Burgard (2011), "A probabilistic framework for learning kinematic models of
articulated objects". Each predicts a state from its joint position q:

    fixed       R = R0,            p = p0
    prismatic   R = R0,            p = p0 + q u
    revolute    R = exp(q u) R0,   p = c + exp(q u) (p0 - c)

A fit is of maximum likelihood, by Gauss-Newton on the whitened residuals (turn, place); the position of each
state is eliminated. A state that fits badly counts less (Student's t).

A kind costs minus the log likelihood of the states, plus half its parameters times log n (BIC). Where a state
is free to move, its position has a density too: a normal one whose spread is that of the positions. A joint
position, or six numbers of a free pair, cost half the log of that variance in units of the noise. A kind is
therefore as good as it is narrow.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from comotion_schemas.hypotheses import JointKind

from ..arrays import Floats
from ..geometry.rotation import rotation_matrix
from .states import States, skew, turns_between

KINDS: tuple[JointKind, ...] = ("fixed", "prismatic", "revolute")
PARAMETERS: dict[JointKind, int] = {"fixed": 6, "prismatic": 8, "revolute": 9}
# Turn of R0, shift of p0, shift of c and turn of the axis, of the last two the parts across the axis.
_TURN, _SHIFT, _POINT, _AXIS = slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 10)
_UNKNOWNS = 10
# Columns of derivatives beside: by the position, and what is left of the state.
_POSITION, _RESIDUAL = _UNKNOWNS, _UNKNOWNS + 1
HEAVY = 30.0
"""Degrees of freedom of Student's t: residuals beyond some five standard deviations count less and less."""
# Steps at most, as fits go on at the next judgement, and the step, in standard deviations squared, below
# which a fit has converged.
_STEPS, _SETTLED = 3, 1e-2
# A direction below this squared length, in standard deviations per unit, does not determine a position.
_NO_DIRECTION = 1e-12
# What has less than this share of the largest information is not determined, as the position 0 of a joint and
# what its kind does not have; it stays as it is.
_UNDETERMINED = 1e-12
# Parameters of a free pair: the mean of six numbers and the spread of each.
_FREE = 12
# Successive states are not independent: so many count as one. A guess that served in docs/research/joints.md.
_TEMPERATURE = 2.0
# What one position, and six numbers, of a state cost on average when they are as spread as expected.
_ALONG, _SIX = 0.5, 0.5 * HEAVY * float(np.log1p(6 / HEAVY))
# Singular values below this share of the largest are rounding.
_RANK = 1e-9


@dataclass(frozen=True)
class Model:
    """A joint of the parent, in the parent's axes."""

    kind: JointKind
    """Which one."""
    R0: Floats
    p0: Floats
    """float64 [3, 3] and [3], the state at position 0."""
    u: Floats
    c: Floats
    """float64 [3] each, axis, and a point on it; zero where the joint does not turn."""

    @property
    def freedom(self) -> int:
        """Numbers of a state that the joint determines."""
        return 6 if self.kind == "fixed" else 5

    def predicted(self, q: Floats) -> tuple[Floats, Floats, Floats]:
        """Turns since position 0 and orientations [n, 3, 3], and places [n, 3], at positions [n].

        A joint that does not turn has one turn and one orientation, [3, 3].
        """
        moved = q[:, None] * self.u
        if self.kind != "revolute":
            return np.eye(3), self.R0, self.p0 + moved
        axis = skew(self.u[None])
        E = np.eye(3) + np.sin(q)[:, None, None] * axis + (1 - np.cos(q))[:, None, None] * (axis @ axis)
        return E, E @ self.R0, self.c + E @ (self.p0 - self.c)

    def positions(self, states: States) -> Floats:
        """Position of each state on the joint, roughly, float64 [n]."""
        if self.kind == "prismatic":
            return np.asarray((states.p - self.p0) @ self.u)
        if self.kind == "revolute":
            return np.asarray(turns_between(states.R, self.R0) @ self.u)
        return np.zeros(len(states))


@dataclass(frozen=True)
class Fit:
    """A model fitted to n states."""

    model: Model
    """The joint."""
    q: Floats
    q_sigma: Floats
    """float64 [n], positions and their one-sigma; zero for a fixed joint."""
    residual: Floats
    squared: Floats
    """float64 [n, 6], whitened residuals, and [n], their squares less what is along the joint."""
    covariance: Floats
    """float64 [10, 10] of (turn of R0, p0, c, axis); c and axis across the axis."""
    improbability: float
    """Minus the log prior of the model, without its constant."""

    @property
    def misfit(self) -> float:
        """Minus the log likelihood of the states, without its constant."""
        # Student's t: near half the square for small ones.
        return float((0.5 * HEAVY * np.log1p(self.squared / HEAVY)).sum())


def fit(states: States, start: Model, reach: float, *, steps: int = _STEPS) -> Fit:
    """Fit a model of the kind of a start to n > 0 states; without steps their positions are fitted alone.

    `reach` is the standard deviation of the distance between the child and the axis of a hinge: a hinge that
    is far away is a slide.
    """
    model, q, near, hinge = start, start.positions(states), states.p.mean(0), start.kind == "revolute"
    for k in range(steps + 1):
        # Two unit vectors across the axis.
        sides = np.linalg.svd(model.u[None])[2][1:]
        white = states.roots @ _derivatives(states, model, q, sides)
        residual, along = white[:, :, _RESIDUAL].copy(), white[:, :, _POSITION].copy()
        # The position of each state is eliminated; what is left along the joint is no residual.
        strength, squares = np.square(along).sum(1) + _NO_DIRECTION, np.square(residual).sum(1)
        share = np.einsum("ni,nik->nk", along, white) / strength[:, None]
        squared = squares - share[:, _RESIDUAL] ** 2 * strength
        white -= along[:, :, None] * share[:, None]
        weight = 1 / (1 + squares / HEAVY)
        J = white.reshape(-1, _UNKNOWNS + 2)
        normal = (J * np.repeat(weight, 6)[:, None]).T @ J
        matrix, gradient = normal[:_UNKNOWNS, :_UNKNOWNS], normal[:_UNKNOWNS, _RESIDUAL]
        away = sides @ (model.c - near)
        if hinge:
            # An axis that no turn determines stays where it is.
            matrix[[6, 7, 8, 9], [6, 7, 8, 9]] += [reach**-2, reach**-2, 1.0, 1.0]
            gradient[_POINT] -= away / reach**2
        values, axes = np.linalg.eigh(matrix)
        determined = values > _UNDETERMINED * values[-1]
        covariance = (axes[:, determined] / values[determined]) @ axes[:, determined].T
        step, extra = covariance @ gradient, share[:, _RESIDUAL]
        # Where the joint does not fit, standard deviations are more than the states say, and a gain changes
        # nothing: one step is enough, and the next judgement goes on. With none it would never fit.
        if k == steps or step @ gradient < _SETTLED * max(float(squared.mean()) / 6, 1.0) ** (1 + (k > 0)):
            break
        q = q + extra - share[:, :_UNKNOWNS] @ step
        model = _moved(model, step, sides)
    sigma = np.sqrt(1 / strength) if model.kind != "fixed" else np.zeros(len(q))
    improbability = 0.5 * float(away @ away) / reach**2 if hinge else 0.0
    return Fit(model, q + extra, sigma, residual, squared, covariance, improbability)


def joint_position(model: Model, state: States) -> float:
    """Position of one state on a joint, the best by its information; 0 if it is fixed."""
    return 0.0 if model.kind == "fixed" else float(fit(state, model, np.inf, steps=0).q[0])


def judge(
    states: States, models: Mapping[JointKind, Model], reach: float
) -> tuple[dict[JointKind, Fit], dict[JointKind, float]]:
    """Fit every kind to n > 0 states, from the models of the last judgement, and weigh them.

    Returns the best fit of each kind, and the probability of each, and of ``free``; they add up to one.
    """
    fits = {kind: fit(states, models.get(kind) or first_guess(states, kind), reach) for kind in KINDS}
    independent = max(len(states) / _TEMPERATURE, 1.0)
    costs: dict[JointKind, float] = {kind: _cost(fitted, independent) for kind, fitted in fits.items()}
    costs["free"] = _free_cost(fits["fixed"], independent)
    values = -np.array(list(costs.values()))
    shares = np.exp(values - values.max())
    return fits, dict(zip(costs, (shares / shares.sum()).tolist(), strict=True))


def first_guess(states: States, kind: JointKind) -> Model:
    """A model near the states, in closed form."""
    middle = len(states) // 2
    R0, p0 = states.R[middle], states.p[middle]
    if kind != "revolute":
        return Model(kind, R0, p0, principal(states.p - states.p.mean(0)), np.zeros(3))
    # (1 - E) c + E p0 = p for all states; along the axis c is where the child is.
    E = states.R @ R0.T
    design = np.concatenate([np.eye(3) - E, E], axis=2).reshape(-1, 6)
    scale = max(float(np.abs(states.p).max()), 1e-6)
    rows = np.vstack([design, 1e-3 * np.hstack([np.eye(3), np.zeros((3, 3))])])
    wanted = np.concatenate([states.p.reshape(-1), 1e-3 * states.p.mean(0)]) / scale
    solution = np.linalg.lstsq(rows, wanted, rcond=_RANK)[0] * scale
    return Model(kind, R0, solution[3:], principal(turns_between(states.R, R0)), solution[:3])


def principal(vectors: Floats) -> Floats:
    """Unit vector along which vectors [n, 3] spread most, towards the later ones."""
    u = np.linalg.svd(vectors, full_matrices=False)[2][0]
    along = vectors @ u
    half = max(len(along) // 2, 1)
    return np.asarray(u if along[half:].sum() >= along[:half].sum() else -u, np.float64)


def _derivatives(states: States, model: Model, q: Floats, sides: Floats) -> Floats:
    """Derivatives of states by the unknowns and by the position, and what is left, float64 [n, 6, 12]."""
    J, u, sides = np.zeros((len(q), 6, _UNKNOWNS + 2)), model.u, sides.T
    E, R, p = model.predicted(q)
    J[:, :3, _TURN] = J[:, 3:, _SHIFT] = E
    J[:, :3, _RESIDUAL], J[:, 3:, _RESIDUAL] = turns_between(states.R, R), states.p - p
    if model.kind == "prismatic":
        J[:, 3:, _POSITION] = u
        J[:, 3:, _AXIS] = -q[:, None, None] * (skew(u[None]) @ sides)
    elif model.kind == "revolute":
        arm = -skew(p - model.c)
        J[:, :3, _POSITION], J[:, 3:, _POSITION] = u, arm @ u
        J[:, :3, _AXIS] = J[:, 3:, _POINT] = bend = sides - E @ sides
        J[:, 3:, _AXIS] = arm @ bend
    return J


def _moved(model: Model, step: Floats, sides: Floats) -> Model:
    """A joint after a step of its unknowns; `sides` are across its axis."""
    R0, p0 = rotation_matrix(step[_TURN]) @ model.R0, model.p0 + step[_SHIFT]
    bend = step[_AXIS] @ sides
    # Beyond a radian the equations are not linear.
    bend /= max(1.0, float(np.linalg.norm(bend)))
    u = rotation_matrix(bend) @ model.u
    return replace(model, R0=R0, p0=p0, u=u, c=model.c + step[_POINT] @ sides)


def _cost(fitted: Fit, independent: float) -> float:
    """Cost of a kind of joint for so many independent states."""
    cost = fitted.misfit / _TEMPERATURE + fitted.improbability
    cost += 0.5 * PARAMETERS[fitted.model.kind] * np.log(independent + 1)
    if fitted.model.kind != "fixed":
        spread = 1 + float(np.mean(((fitted.q - fitted.q.mean()) / fitted.q_sigma) ** 2))
        cost += independent * (0.5 * np.log(spread) + _ALONG)
    return float(cost)


def _free_cost(fitted: Fit, independent: float) -> float:
    """Cost of the states of a fixed joint with a normal density in six dimensions around their mean."""
    spreads = np.linalg.eigvalsh(fitted.residual.T @ fitted.residual / len(fitted.residual))
    cost = 0.5 * np.log(np.maximum(spreads, 1.0)).sum() + _SIX
    return float(independent * cost + 0.5 * _FREE * np.log(independent + 1))
