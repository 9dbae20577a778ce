"""Trajectories to bodies: motion cost, spatial prior and a preference to stay, by Bayes' rule."""

from dataclasses import dataclass

import numpy as np

from ..window import Bools, Floats
from .config import MotionConfig
from .frames import Frames
from .tracks import Ints

OUTLIER = -1
_SWEEPS = 3
# A trajectory speaks for its body's shape in full after this long, s.
_SETTLED = 1.0
# The dead speak too, if they lived for so many frames.
DEAD_FRAMES = 8
# Smallest variance of a density in any direction, as a share of all.
_FLATTEST = 1e-9


@dataclass(frozen=True)
class Assignment:
    """`labels` intp [N], column of the body or :data:`OUTLIER`; `cost` float64 [N, 1 + K], outlier first."""

    labels: Ints
    cost: Floats


def cheapest(body: Floats, outlier: Floats) -> Ints:
    """Column of the cheapest body, or :data:`OUTLIER`, intp [N]."""
    return np.asarray(np.argmin(np.column_stack([outlier, body]), 1) - 1)


def assign(
    frames: Frames, body: Floats, outlier: Floats, before: Ints, where: Floats, config: MotionConfig
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
    clarity = 1 - np.exp(-np.maximum(ordered[:, 1] - ordered[:, 0], 0))
    voice = _voice(frames, config)
    spacing = _spacing(where, voice > 0)
    cost = evidence
    for sweep in range(_SWEEPS):
        prior = _log_prior(
            where[:, : frames.dim], labels, voice * (clarity if sweep == 0 else 1.0), body.shape[1], spacing
        )
        prior = np.maximum(prior, -config.prior_floor)
        cost = evidence - config.prior_weight * np.column_stack([np.zeros(len(prior)), prior])
        found = np.asarray(np.argmin(cost, 1) - 1)
        if np.array_equal(found, labels):
            break
        labels = found
    return Assignment(labels, cost)


def _voice(frames: Frames, config: MotionConfig) -> Floats:
    settled = _SETTLED * config.frame_rate
    counts: Bools = frames.alive | (frames.life >= DEAD_FRAMES)
    return np.where(counts, np.minimum(frames.life, settled) / settled, 0.0)


def _spacing(where: Floats, counts: Bools) -> float:
    """Median squared distance to the nearest neighbour."""
    x = where[counts]
    if len(x) < 2:
        return 1.0
    squared = ((x[:, None] - x[None]) ** 2).sum(2)
    np.fill_diagonal(squared, np.inf)
    return max(float(np.median(squared.min(1))), 1e-18)


def _log_prior(x: Floats, labels: Ints, voice: Floats, bodies: int, spacing: float) -> Floats:
    """Log of each body's density of members at x [N, dim], relative to the densest there, [N, K]."""
    found = np.full((len(x), bodies), -np.inf)
    for k in range(bodies):
        members = np.flatnonzero((labels == k) & (voice > 0))
        if len(members):
            found[:, k] = _log_density(x, members, voice[members], spacing)
    top = found.max(1, keepdims=True, initial=-np.inf)
    return np.where(np.isfinite(top), found - np.where(np.isfinite(top), top, 0.0), 0.0)


def _log_density(x: Floats, members: Ints, voice: Floats, spacing: float) -> Floats:
    """Kernel density at x, each left out of its own, [N].

    The kernel has the shape of the body's own spread, drawn to the scene's spacing where members are
    few, and Scott's bandwidth n^(-1/(dim + 4)).
    """
    dim = x.shape[1]
    total = voice.sum()
    z = x[members] - (voice[:, None] * x[members]).sum(0) / total
    spread = np.einsum("n,ni,nj->ij", voice, z, z)
    # Coincident features on a line or plane leave no spacing: stay clear of rounding.
    spread += max(spacing, _FLATTEST * np.trace(spread)) * np.eye(dim)
    spread /= total + dim
    bandwidth = spread * max(total, 1.0) ** (-2 / (dim + 4))
    whiten = np.linalg.inv(np.linalg.cholesky(bandwidth))
    white = x @ whiten.T
    squared = ((white[:, None] - white[None, members]) ** 2).sum(2)
    kernel = np.exp(-0.5 * squared) * voice
    kernel[members, np.arange(len(members))] = 0.0
    return np.asarray(np.log(kernel.sum(1) + 1e-300) + np.log(np.diag(whiten)).sum())
