"""Trajectories to bodies: motion cost, spatial prior and a preference to stay, by Bayes' rule."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..config import RigidConfig
from . import density
from .frames import Frames

OUTLIER = -1
_SWEEPS = 3
# A trajectory speaks for its body's shape in full after this long, s.
_SETTLED = 1.0
# The dead speak too, if they lived for so many frames.
DEAD_FRAMES = 8
# Evidence so far beyond what the prior can outweigh, nat, leaves neither a label nor a confidence open.
_BEYOND = 30.0


@dataclass(frozen=True)
class Assignment:
    """`labels` intp [N], column of the body or :data:`OUTLIER`; `cost` float64 [N, 1 + K], outlier first."""

    labels: Ints
    cost: Floats


def cheapest(body: Floats, outlier: Floats) -> Ints:
    """Column of the cheapest body, or :data:`OUTLIER`, intp [N]."""
    return np.asarray(np.argmin(np.column_stack([outlier, body]), 1) - 1)


def assign(
    frames: Frames, body: Floats, outlier: Floats, before: Ints, where: Floats, config: RigidConfig
) -> Assignment:
    """Assign every trajectory to a body.

    The prior of body k at x is the kernel density of its members there: it decides for a newborn,
    of which only the position is known, and is outweighed as evidence of motion adds up.

    Parameters
    ----------
    body, outlier
        float64 [N, K] and [N], costs in nats.
    before
        intp [N], column that continues the hypothesis a trajectory was in; -1 for none.
    where
        float64 [N, 3], position now; of a dead one where its body has carried it.
    """
    evidence = np.column_stack([outlier, body])
    stays = np.flatnonzero(before >= 0)
    evidence[stays, before[stays] + 1] -= config.stay
    labels = np.asarray(np.argmin(evidence, 1) - 1)
    ordered = np.partition(evidence, 1, axis=1)
    margin = np.maximum(ordered[:, 1] - ordered[:, 0], 0)
    clarity = 1 - np.exp(-margin)
    asked = np.flatnonzero(margin < config.prior_weight * config.prior_floor + _BEYOND)
    voice = _voice(frames, config)
    x = np.ascontiguousarray(where[:, : frames.dim])
    spacing = density.spacing(x[voice > 0])
    cost = evidence
    for sweep in range(_SWEEPS):
        heard = voice * (clarity if sweep == 0 else 1.0)
        prior = np.maximum(_log_prior(x, asked, labels, heard, body.shape[1], spacing), -config.prior_floor)
        cost = evidence.copy()
        cost[asked, 1:] -= config.prior_weight * prior
        found = np.asarray(np.argmin(cost, 1) - 1)
        if np.array_equal(found, labels):
            break
        labels = found
    return Assignment(labels, cost)


def _voice(frames: Frames, config: RigidConfig) -> Floats:
    settled = _SETTLED * config.frame_rate
    counts: Bools = frames.alive | (frames.life >= DEAD_FRAMES)
    return np.where(counts, np.minimum(frames.life, settled) / settled, 0.0)


def _log_prior(x: Floats, asked: Ints, labels: Ints, voice: Floats, bodies: int, spacing: float) -> Floats:
    """Log of each body's density of members at x[asked], relative to the densest there, [n, K]."""
    found = np.full((len(asked), bodies), -np.inf)
    for k in range(bodies):
        members = np.flatnonzero((labels == k) & (voice > 0))
        if len(members):
            found[:, k] = density.log_density(x, asked, members, voice[members], spacing)
    top = found.max(1, keepdims=True, initial=-np.inf)
    return np.where(np.isfinite(top), found - np.where(np.isfinite(top), top, 0.0), 0.0)
