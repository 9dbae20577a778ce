"""Assigns trajectories to bodies by costs and positions (step 9), with probabilities."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from ..arrays import Floats, Ints, last_true, thinned
from ..config import RigidConfig
from ..partition import NO_HYPOTHESIS
from .costs import Costs, updated
from .frames import DRAWN, SETTLED, Frames
from .kernels.rotation import ROUNDING
from .procrustes import Body

OUTLIER = NO_HYPOTHESIS
"""Label of a trajectory that belongs to no body."""
SURE = 40.0
"""nat; margin of evidence of a clear membership, which no place changes. Chosen on stress scenes of even
seeds and on the markers."""
# Rounds of prior and assignment at most; chosen on the scenes of docs/research/accuracy.md.
_ROUNDS = 3


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
        members = [np.ascontiguousarray(body[labels == k].T) for k in range(body.shape[1])]
        return np.stack([(costs - costs[k]).sum(1) for k, costs in enumerate(members)])


def without_sliders(labels: Ints, costs: Costs) -> Ints:
    """The labels, intp [N], but :data:`OUTLIER` for features that slide: they do not constrain a pose."""
    if not costs.slides.any():
        return labels
    sliding = (labels >= 0) & costs.slides[np.arange(len(labels)), np.maximum(labels, 0)]
    return np.where(sliding, OUTLIER, labels)


def cheapest(body: Floats, outlier: Floats) -> Ints:
    """Column of the cheapest body, or :data:`OUTLIER`, intp [N], by costs float64 [N, K] and [N]."""
    return np.asarray(np.argmin(np.column_stack([outlier, body]), 1) - 1)


def assign(
    frames: Frames, body: Floats, outlier: Floats, position: Floats, config: RigidConfig
) -> Assignment:
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
        cost[unclear, 1:] += _place_costs(x, unclear, labels, counted, body.shape[1], spacing, config)
        new_labels = np.asarray(np.argmin(cost, 1) - 1)
        if np.array_equal(new_labels, labels):
            break
        labels, counted = new_labels, weight
    return Assignment(labels, cost, spacing)


def joined(
    frames: Frames, newest: Floats, result: SearchResult, rejoining: Ints, config: RigidConfig
) -> SearchResult:
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
    evidence = updated(frames, bodies, result.evidence, joining, config)
    labels = np.append(result.assignment.labels, np.full(len(frames.key) - known_count, OUTLIER))
    labels[rejoining] = OUTLIER
    x = np.ascontiguousarray(predicted_positions(frames, newest, bodies, labels)[:, : frames.dim])
    spacing = result.assignment.spacing
    place = _place_costs(x, joining, labels, _weight(frames), len(bodies), spacing, config)
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
    all_rows = np.flatnonzero(ended[frames.owner])
    owners, first = np.unique(frames.owner[all_rows], return_index=True)
    for k, body in enumerate(bodies):
        members = labels[owners] == k
        if not (members.any() and body.posed.any()):
            continue
        rows, tracks = all_rows[first[members]], owners[members]
        both = (frames.w[rows] > 0) & body.posed
        last = last_true(both)
        held = both[np.arange(len(last)), last]
        rows, tracks, last = rows[held], tracks[held], last[held]
        inside = np.einsum("nji,nj->ni", body.R[last], frames.y[rows, last] - body.t[last])
        now = np.flatnonzero(body.posed)[-1]
        position[tracks] = inside @ body.R[now].T + body.t[now]
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
    x: Floats, points: Ints, labels: Ints, weight: Floats, bodies: int, spacing: float, config: RigidConfig
) -> Floats:
    """Cost of each body at x[points], nat [n, K]: minus the log density of its members, beyond the least."""
    log_density, labels = np.full((len(points), bodies), -np.inf), np.where(weight > 0, labels, OUTLIER)
    for k in range(bodies):
        members = np.flatnonzero(labels == k)
        if len(members):
            log_density[:, k] = _log_density(x, points, members, weight[members], spacing)
    top = log_density.max(1, keepdims=True, initial=-np.inf)
    cost = np.where(np.isfinite(top), np.where(np.isfinite(top), top, 0.0) - log_density, 0.0)
    return np.minimum(cost, config.prior_floor)


def _log_density(x: Floats, points: Ints, members: Ints, weight: Floats, spacing: float) -> Floats:
    """Log of the kernel density of members at x[points]; none counts at its own place. Float64 [n].

    The kernel has the shape of the members' covariance, with the scene's spacing added where they are few,
    and the bandwidth n^(-1/(dim + 4)) of Scott (1992).
    """
    dim, total, own = x.shape[1], weight.sum(), x.take(members, 0)
    z = own - (weight[:, None] * own).sum(0) / total
    spread = (weight[:, None] * z).T @ z
    # Coincident features on a line or plane have no spacing: the kernel must stay above rounding.
    spread += max(spacing, ROUNDING * spread.trace()) * np.eye(dim)
    spread /= total + dim
    bandwidth = spread * max(total, 1.0) ** (-2 / (dim + 4))
    whiten = np.linalg.inv(np.linalg.cholesky(bandwidth))
    own, members, weight = (thinned(values, DRAWN) for values in (own, members, weight))
    near = np.exp(-0.5 * cdist(x[points] @ whiten.T, own @ whiten.T, "sqeuclidean"))
    near[points[:, None] == members] = 0.0
    sums = near @ (weight * (total / weight.sum()))
    return np.asarray(np.log(sums + 1e-300) + np.log(whiten.diagonal()).sum())


def _spacing(x: Floats) -> float:
    """Median squared distance of points [n, dim] to their nearest neighbour."""
    if len(x) < 2:
        return 1.0
    drawn = x[thinned(np.arange(len(x)), DRAWN)]
    return max(float(np.median(cKDTree(x).query(drawn, 2)[0][:, 1] ** 2)), 1e-18)
