"""Probability of each kind of joint, from how well each fits.

A kind costs minus the log likelihood of the states, plus half its parameters times log n (BIC). Where a state
is free to move, its position has a density too: a normal one whose spread is that of the positions. A joint
position, or six numbers of a free pair, cost half the log of that variance in units of the noise. A kind is
therefore as good as it is narrow.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comotion_schemas.hypotheses import JointKind

from ..arrays import Floats
from .fitting import HEAVY, Fit, fit
from .models import FREE_PARAMETERS, FixedKind, Model
from .states import States, quantiles, turns_between

KINDS: tuple[FixedKind, ...] = ("fixed", "prismatic", "revolute")
# Parameters of a free pair: the mean of six numbers and the spread of each.
_FREE = 12
# Successive states are not independent: so many count as one. A guess that served in docs/research/joints.md.
_TEMPERATURE = 2.0
# States; residuals farther apart are taken to be independent: pairs of frames over two seconds.
_LAGS = 15
DEGREES: Mapping[FixedKind, int] = {"fixed": 0, "prismatic": 1, "revolute": 1}
"""Degrees of freedom of each kind."""
# Probability below which a kind is fitted in few steps.
_HOPELESS = 1e-9
# Singular values below this share of the largest are rounding.
_RANK = 1e-9


@dataclass(frozen=True)
class Verdict:
    """What the states of a pair say.

    Attributes
    ----------
    fits
        The best fit of each kind.
    probability
        Of each kind, :data:`KINDS` and ``free``; they add up to one.
    turn, shift
        How far the pair has moved: rad and the unit of the space, from end to end.
    span_ns
        From the first to the last state.
    """

    fits: Mapping[FixedKind, Fit]
    probability: dict[JointKind, float]
    turn: float
    shift: float
    span_ns: int

    @property
    def best(self) -> JointKind:
        """The most probable kind."""
        return max(self.probability, key=lambda kind: self.probability[kind])


def judge(
    states: States, known: Mapping[FixedKind, Model], chances: Mapping[JointKind, float], reach: float
) -> Verdict:
    """Fit every kind to n > 0 states and weigh them.

    Parameters
    ----------
    known, chances
        Models of the last judgement, from which fits start, and how probable each kind was.
    reach
        How far from the child a hinge may be, as in :func:`fit`.
    """
    fits: dict[FixedKind, Fit] = {}
    for kind in KINDS:
        start = known.get(kind) if kind != "fixed" else None
        hopeless = start is not None and chances.get(kind, 1.0) < _HOPELESS
        fits[kind] = fit(states, start or first_guess(states, kind), reach, hopeless=hopeless)
    costs: dict[JointKind, float] = {kind: _cost(one) for kind, one in fits.items()}
    costs["free"] = _free_cost(fits["fixed"])
    values = -np.array(list(costs.values()))
    shares = np.exp(values - values.max())
    shares /= shares.sum()
    turn, shift = _extent(states, fits["fixed"].model)
    return Verdict(
        fits, dict(zip(costs, shares.tolist(), strict=True)), turn, shift, int(np.ptp(states.stamps))
    )


def excess(one: Fit) -> float:
    """How many times wider than its covariance a fit is: residuals that are large and last have few samples.

    Their mean square, times the integrated autocorrelation time by a Bartlett window (Newey and West 1987);
    not below 1.
    """
    count = len(one.residual)
    lags = np.arange(1, min(_LAGS, count // 3) + 1)
    square = float((one.residual**2).sum())
    if not len(lags) or square <= 0:
        return 1.0
    shares = [float((one.residual[k:] * one.residual[:-k]).sum()) / square for k in lags.tolist()]
    time = 1 + 2 * float(((1 - lags / (lags[-1] + 1)) * shares).sum())
    return max(square / count / (6 - DEGREES[one.model.kind]) * max(time, 1.0), 1.0)


def first_guess(states: States, kind: FixedKind) -> Model:
    """A model near the states, in closed form."""
    middle = len(states) // 2
    R0, p0 = states.R[middle], states.p[middle]
    if kind != "revolute":
        u = _principal(states.p - states.p.mean(0)) if kind == "prismatic" else np.eye(3)[2]
        return Model(kind, R0, p0, u, np.zeros(3))
    u = _principal(turns_between(states.R, R0))
    # (1 - E) c + E p0 = p for all states; along the axis c is where the child is.
    E = states.R @ R0.T
    design = np.concatenate([np.eye(3) - E, E], axis=2).reshape(-1, 6)
    scale = max(float(np.abs(states.p).max()), 1e-6)
    rows = np.vstack([design, 1e-3 * np.hstack([np.eye(3), np.zeros((3, 3))])])
    wanted = np.concatenate([states.p.reshape(-1), 1e-3 * states.p.mean(0)]) / scale
    found = np.linalg.lstsq(rows, wanted, rcond=_RANK)[0] * scale
    return Model(kind, R0, found[3:], u, found[:3])


def _principal(vectors: Floats) -> Floats:
    """Unit vector along which vectors [n, 3] spread most, towards the later ones."""
    _, _, axes = np.linalg.svd(vectors, full_matrices=False)
    u = axes[0]
    along = vectors @ u
    half = max(len(along) // 2, 1)
    return np.asarray(u if along[half:].sum() >= along[:half].sum() else -u, np.float64)


def _cost(one: Fit) -> float:
    n = len(one.q)
    independent = max(n / _TEMPERATURE, 1.0)
    likelihood = (one.cost - one.improbability) / _TEMPERATURE
    total = likelihood + one.improbability + 0.5 * FREE_PARAMETERS[one.model.kind] * np.log(independent + 1)
    if one.model.kind != "fixed":
        spread = 1 + float(np.mean(((one.q - one.q.mean()) / one.q_sigma) ** 2))
        total += independent * (0.5 * np.log(spread) + _density(1))
    return float(total)


def _free_cost(one: Fit) -> float:
    """Cost of the states of a fixed joint with a normal density in six dimensions around their mean."""
    n = len(one.residual)
    independent = max(n / _TEMPERATURE, 1.0)
    spreads = np.linalg.eigvalsh(one.residual.T @ one.residual / n)
    cost = 0.5 * np.log(np.maximum(spreads, 1.0)).sum() + _density(6)
    return float(independent * cost + 0.5 * _FREE * np.log(independent + 1))


def _density(dimensions: int) -> float:
    """What so many dimensions of a state cost on average when they are as spread as expected."""
    return float(0.5 * HEAVY * np.log1p(dimensions / HEAVY)) if dimensions == 6 else 0.5


def _extent(states: States, middle: Model) -> tuple[float, float]:
    """Largest turn and shift between states, nearly; by the ends of their principal directions."""
    turns = turns_between(states.R, middle.R0)
    return _span(turns), _span(states.p)


def _span(vectors: Floats) -> float:
    along = vectors @ _principal(vectors - vectors.mean(0))
    low, high = quantiles(along, (0.02, 0.98))
    return high - low
