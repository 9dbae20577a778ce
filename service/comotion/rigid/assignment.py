"""Assigns trajectories to bodies by costs and positions (step 9), with probabilities."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ..arrays import Floats, Ints, last_true, thinned
from ..geometry.body import Body, stacked
from ..geometry.frames import DRAWN, SETTLED, Frames
from ..geometry.rotation import ROUNDING
from ..partition import NO_HYPOTHESIS
from .costs import Costs, updated

OUTLIER = NO_HYPOTHESIS
"""Label of a trajectory that belongs to no body."""
SURE = 40.0
"""nat; margin of evidence of a clear membership, which no place changes. Chosen on stress scenes of even
seeds and on the markers."""
# Rounds of prior and assignment at most; chosen on the scenes of docs/research/accuracy.md.
_ROUNDS = 3
# nat; most that the place of a trajectory says about its body.
_MOST_PLACE = 6.0


@dataclass(frozen=True)
class Assignment:
    """The body of each of N trajectories.

    Attributes
    ----------
    labels, cost
        Intp [N], column of the body or :data:`OUTLIER`; float64 [N, 1 + K], outlier first.
    spacing
        Median squared distance of neighbours, in which densities are smooth.
    """

    labels: Ints
    cost: Floats
    spacing: float


@dataclass(frozen=True)
class SearchResult:
    """Bodies of a scene, the static one first, and the assignment of its N trajectories to them.

    `evidence` holds the costs before any prior.
    """

    bodies: list[Body]
    assignment: Assignment
    evidence: Costs

    @cached_property
    def gains(self) -> Floats:
        """By how much members of each body are cheaper under it than under each, float64 [K, K], nat."""
        body, labels = self.evidence.body, self.assignment.labels
        paid = (labels == np.arange(body.shape[1])[:, None]) @ body
        return np.asarray(paid - paid.diagonal()[:, None], np.float64)


def without_sliders(labels: Ints, costs: Costs) -> Ints:
    """The labels, intp [N], but :data:`OUTLIER` for features that slide: they do not constrain a pose."""
    if not costs.slides.any():
        return labels
    sliding = (labels >= 0) & costs.slides[np.arange(len(labels)), np.maximum(labels, 0)]
    return np.where(sliding, OUTLIER, labels)


def cheapest(body: Floats, outlier: Floats) -> Ints:
    """Column of the cheapest body, or :data:`OUTLIER`, intp [N], by costs float64 [N, K] and [N]."""
    return np.asarray(np.argmin(np.column_stack([outlier, body]), 1) - 1)


def assign(frames: Frames, body: Floats, outlier: Floats, position: Floats) -> Assignment:
    """Assign every trajectory to a body by motion cost and spatial prior.

    The prior of body k at x is the kernel density of its members there. It decides for a newborn
    trajectory, of which only the position is known; evidence of motion soon outweighs it.

    Parameters
    ----------
    body, outlier
        float64 [N, K] and [N], costs in nats.
    position
        float64 [N, 3], newest position; of an ended trajectory, where its body has moved it since.
    """
    evidence = np.column_stack([outlier, body])
    labels = np.asarray(np.argmin(evidence, 1) - 1)
    weight, x = _weight(frames), np.ascontiguousarray(position[:, : frames.dim])
    least, spacing = np.partition(evidence, 1, axis=1), _spacing(x[weight > 0])
    margin = least[:, 1] - least[:, 0]
    unclear = np.flatnonzero(margin < SURE)
    if not len(unclear):
        return Assignment(labels, evidence, spacing)
    # In the first round a trajectory has weight in its body only as far as its evidence is clear.
    counted = weight * (1 - np.exp(-margin))
    cost = evidence
    for _ in range(_ROUNDS):
        cost = evidence.copy()
        cost[unclear, 1:] += _place_costs(x, unclear, labels, counted, body.shape[1], spacing)
        new_labels = np.asarray(np.argmin(cost, 1) - 1)
        if np.array_equal(new_labels, labels):
            break
        labels, counted = new_labels, weight
    return Assignment(labels, cost, spacing)


def joined(frames: Frames, newest: Floats, result: SearchResult, rejoining: Ints) -> SearchResult:
    """The result with trajectories that are new, the last ones of `frames`, and `rejoining` ones reassigned.

    Parameters
    ----------
    newest
        float64 [N, 3], positions of all trajectories.
    rejoining
        intp [n], ascending; all others keep their bodies.
    """
    bodies, known_count = result.bodies, len(result.assignment.labels)
    joining = np.append(rejoining, np.arange(known_count, len(frames.key)))
    evidence = updated(frames, bodies, result.evidence, joining)
    labels = np.append(result.assignment.labels, np.full(len(frames.key) - known_count, OUTLIER))
    labels[rejoining] = OUTLIER
    x = np.ascontiguousarray(predicted_positions(frames, newest, bodies, labels)[:, : frames.dim])
    spacing = result.assignment.spacing
    place = _place_costs(x, joining, labels, _weight(frames), len(bodies), spacing)
    cost = np.zeros((len(labels), 1 + len(bodies)))
    cost[:known_count] = result.assignment.cost
    cost[joining] = np.column_stack([evidence.outlier, evidence.body])[joining]
    cost[joining, 1:] += place
    labels[joining] = np.argmin(cost[joining], 1) - 1
    return SearchResult(bodies, Assignment(labels, cost, spacing), evidence)


def predicted_positions(frames: Frames, newest: Floats, bodies: list[Body], labels: Ints) -> Floats:
    """Position of each trajectory now, float64 [N, 3]: its newest, or where its body has moved it since.

    Parameters
    ----------
    newest, labels
        float64 [N, 3], newest position, and intp [N], body of each trajectory or :data:`OUTLIER`.
    """
    position = newest.copy()
    ended = ~frames.current & (labels > 0)
    # The first row of a trajectory is its position, or the end of its first arm.
    rows = np.flatnonzero(ended[frames.owner])
    tracks, first = np.unique(frames.owner[rows], return_index=True)
    poses, rows, k = stacked(bodies), rows[first], labels[tracks]
    both = (frames.w[rows] > 0) & (poses[k, :, 12] > 0)
    held, last = both.any(1), last_true(both)
    tracks, rows, k, last = tracks[held], rows[held], k[held], last[held]
    then, now = poses[k, last], poses[np.arange(len(bodies)), last_true(poses[:, :, 12] > 0)][k]
    # From where they were last seen to now.
    inside = ((frames.y[rows, last] - then[:, 9:12])[:, None] @ then[:, :9].reshape(-1, 3, 3))[:, 0]
    position[tracks] = (now[:, :9].reshape(-1, 3, 3) @ inside[:, :, None])[:, :, 0] + now[:, 9:12]
    return position


def posterior(cost: Floats) -> Floats:
    """Probability of being an outlier and of belonging to each body, by its cost, float64 [N, 1 + K]."""
    chances = np.exp(cost.min(1, keepdims=True) - cost)
    return np.asarray(chances / chances.sum(1, keepdims=True))


def same_body(chances: Floats) -> NDArray[np.float32]:
    """Probability that two trajectories belong to one body, float32 [n, n]; 1 on the diagonal."""
    same = (chances[:, 1:] @ chances[:, 1:].T).astype(np.float32)
    np.fill_diagonal(same, 1.0)
    return same


def _weight(frames: Frames) -> Floats:
    """Weight of each trajectory in the density of its body, 0 to 1, float64 [N]."""
    return np.where(frames.informative, np.minimum(frames.life / SETTLED, 1.0), 0.0)


def _place_costs(
    x: Floats, points: Ints, labels: Ints, weight: Floats, bodies: int, spacing: float
) -> Floats:
    """Cost of each body at x[points], nat [n, K]: minus the log density of its members, beyond the least.

    The density is by kernels that have the shape of the members' covariance, with the scene's spacing added
    where they are few, and the bandwidth n^(-1/(dim + 4)) of Scott (1992). None counts at its own place.
    """
    dim, log_density = x.shape[1], np.full((len(points), bodies), -np.inf)
    counted = weight * (labels == np.arange(bodies)[:, None])
    total = counted.sum(1)
    own = x - (counted @ x / np.maximum(total, 1e-300)[:, None])[labels]
    spread = (counted @ (own[:, :, None] * own[:, None]).reshape(len(x), -1)).reshape(-1, dim, dim)
    # Coincident features on a line or plane have no spacing: the kernel must stay above rounding.
    least = np.maximum(spacing, ROUNDING * np.trace(spread, axis1=1, axis2=2))
    scale = np.maximum(total, 1.0) ** (-2 / (dim + 4)) / (total + dim)
    bandwidth = (spread + least[:, None, None] * np.eye(dim)) * scale[:, None, None]
    whiten = np.linalg.inv(np.linalg.cholesky(bandwidth))
    for k in np.flatnonzero(total).tolist():
        members = thinned(np.flatnonzero(counted[k]), DRAWN)
        near = np.exp(-0.5 * cdist(x[points] @ whiten[k].T, x[members] @ whiten[k].T, "sqeuclidean"))
        near[points[:, None] == members] = 0.0
        sums = near @ (weight[members] * (total[k] / weight[members].sum()))
        log_density[:, k] = np.log(sums + 1e-300) + np.log(whiten[k].diagonal()).sum()
    top = log_density.max(1, keepdims=True, initial=-np.inf)
    cost = np.where(np.isfinite(top), np.where(np.isfinite(top), top, 0.0) - log_density, 0.0)
    return np.minimum(cost, _MOST_PLACE)


def _spacing(x: Floats) -> float:
    """Median squared distance of points [n, dim] to their nearest neighbour."""
    if len(x) < 2:
        return 1.0
    drawn = x[thinned(np.arange(len(x)), DRAWN)]
    return max(float(np.median(cKDTree(x).query(drawn, 2)[0][:, 1] ** 2)), 1e-18)
