"""Probability of each kind of joint, from how well each fits.

A kind costs minus the log likelihood of the states, plus half its parameters times log n (BIC). Where a state
is free to move, its position has a density too: a normal one whose spread is that of the positions. A joint
position, or six numbers of a free pair, cost half the log of that variance in units of the noise. A kind is
therefore as good as it is narrow.
"""

from collections.abc import Mapping

import numpy as np

from comotion_schemas.hypotheses import JointKind

from ..arrays import Floats
from .models import HEAVY, KINDS, PARAMETERS, Fit, Model, fit
from .states import States, turns_between

# Parameters of a free pair: the mean of six numbers and the spread of each.
_FREE = 12
# Successive states are not independent: so many count as one. A guess that served in docs/research/joints.md.
_TEMPERATURE = 2.0
# What one position, and six numbers, of a state cost on average when they are as spread as expected.
_POSITION, _SIX = 0.5, 0.5 * HEAVY * float(np.log1p(6 / HEAVY))
# Singular values below this share of the largest are rounding.
_RANK = 1e-9


def judge(
    states: States, known: Mapping[JointKind, Model], reach: float
) -> tuple[dict[JointKind, Fit], dict[JointKind, float]]:
    """Fit every kind to n > 0 states and weigh them.

    Parameters
    ----------
    states
        Of the pair.
    known
        Models of the last judgement, from which fits start.
    reach
        How far from the child a hinge may be, as in :func:`fit`.

    Returns
    -------
    The best fit of each kind, and the probability of each, and of ``free``; they add up to one.
    """
    fits = {kind: fit(states, known.get(kind) or first_guess(states, kind), reach) for kind in KINDS}
    independent = max(len(states) / _TEMPERATURE, 1.0)
    costs: dict[JointKind, float] = {kind: _cost(one, independent) for kind, one in fits.items()}
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
    found = np.linalg.lstsq(rows, wanted, rcond=_RANK)[0] * scale
    return Model(kind, R0, found[3:], principal(turns_between(states.R, R0)), found[:3])


def principal(vectors: Floats) -> Floats:
    """Unit vector along which vectors [n, 3] spread most, towards the later ones."""
    u = np.linalg.svd(vectors, full_matrices=False)[2][0]
    along = vectors @ u
    half = max(len(along) // 2, 1)
    return np.asarray(u if along[half:].sum() >= along[:half].sum() else -u, np.float64)


def _cost(one: Fit, independent: float) -> float:
    """Cost of a kind of joint for so many independent states."""
    cost = one.misfit / _TEMPERATURE + one.improbability
    cost += 0.5 * PARAMETERS[one.model.kind] * np.log(independent + 1)
    if one.model.kind != "fixed":
        spread = 1 + float(np.mean(((one.q - one.q.mean()) / one.q_sigma) ** 2))
        cost += independent * (0.5 * np.log(spread) + _POSITION)
    return float(cost)


def _free_cost(one: Fit, independent: float) -> float:
    """Cost of the states of a fixed joint with a normal density in six dimensions around their mean."""
    spreads = np.linalg.eigvalsh(one.residual.T @ one.residual / len(one.residual))
    cost = 0.5 * np.log(np.maximum(spreads, 1.0)).sum() + _SIX
    return float(independent * cost + 0.5 * _FREE * np.log(independent + 1))
