"""Costs of trajectories under bodies, in nats (step 7): negative log likelihoods, and prices of bodies."""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..geometry.body import Body, stacked
from ..geometry.frames import Frames
from ..geometry.residuals import body_costs

CAP = 16.0
"""Squared residual per dimension, in tolerances, from which on it costs no more."""
# Share of the cap that a frame of an outlier costs.
_OUTLIER_SHARE = 0.5
# Charge for a frame in which a body has no pose, as a share of the cap, where it covers little of a
# trajectory: more than that of an outlier, or a body without poses would be the cheapest. Chosen on the
# scenes of docs/research/accuracy.md.
_UNCOVERED_SHARE = 0.7
# Variances of the deformation of a body that are compared, in tolerances of its rows, and its correlation
# time, s: from .3 to 1 s it hardly matters, 4 s lose slow bodies (docs/research/unseen.md).
_DEFORMATIONS = np.append(0.0, 2.0 ** np.arange(-1, 7))
_DEFORMATION_TIME = 0.7
# Most that a body deforms, as a share of how it moves; chosen on half of the recordings of
# docs/research/unseen.md.
_MOST_DEFORMATION = 0.2


@dataclass(frozen=True)
class Costs:
    """Costs in nats of N trajectories and P rows under K bodies.

    A cost is the negative log likelihood of the trajectory in the body's frame, where it is a constant, white
    and slow noise, and the deformation of the body; see :func:`~comotion.geometry.residuals.body_costs`. The
    price of opening is that of the body's path before the data are seen.

    Attributes
    ----------
    body, outlier
        float64 [N, K] and [N].
    opening, soft
        float64 [K], price of each body, and variance of its deformation.
    slides
        bool [N, K], whether a cost is that of a feature that slides on the body.
    squared
        float64 [P, K], mean squared residual of each row, NaN where it was not computed.
    """

    body: Floats
    outlier: Floats
    opening: Floats
    soft: Floats
    slides: Bools
    squared: Floats

    def of(self, chosen: list[int]) -> "Costs":
        """The costs of some bodies only, by column."""
        of_bodies = self.opening[chosen], self.soft[chosen], self.slides[:, chosen], self.squared[:, chosen]
        return Costs(self.body[:, chosen], self.outlier, *of_bodies)


def updated(frames: Frames, bodies: list[Body], costs: Costs, tracks: Ints) -> Costs:
    """The costs, with those of `tracks` intp [n], ascending, computed anew.

    They include all new trajectories, which are the last ones of `frames`, as are their rows.
    """
    part, rows = frames.of(tracks), frames.rows_of(tracks)
    body, squared = body_costs_of(part, bodies, costs.soft)
    new_count, shape = len(frames.key) - len(costs.outlier), (len(frames.owner), len(bodies))
    new_costs = replace(
        costs,
        body=np.concatenate([costs.body, np.zeros((new_count, len(bodies)))]),
        outlier=np.append(costs.outlier, np.zeros(new_count)),
        slides=np.concatenate([costs.slides, np.zeros((new_count, len(bodies)), np.bool_)]),
        squared=np.concatenate([costs.squared, np.zeros((shape[0] - len(costs.squared), shape[1]))]),
    )
    new_costs.body[tracks], new_costs.squared[rows] = body, squared
    new_costs.outlier[tracks], new_costs.slides[tracks] = outlier_costs(part)[1], False
    return new_costs


def body_costs_of(frames: Frames, bodies: list[Body], soft: Floats) -> tuple[Floats, Floats]:
    """Cost of each trajectory, float64 [N, K], and mean squared residual of each row, [P, K]."""
    rows = np.arange(len(frames.owner))
    row_costs, squared = _residuals(frames, stacked(bodies), rows, soft)
    return np.stack([frames.per_track(column) for column in row_costs.T], 1), squared


def outlier_costs(frames: Frames) -> tuple[Floats, Floats]:
    """Frames in which each trajectory is observed, and its cost as an outlier, float64 [N] each."""
    seen = frames.per_track((frames.w > 0).sum(1).astype(np.float64))
    return seen, 0.5 * _OUTLIER_SHARE * CAP * frames.dim * seen


def excess_costs(evidence: Costs, labels: Ints) -> Floats:
    """Excess of the cost of each trajectory over the usual cost in its hypothesis, float64 [N].

    In standard deviations: half a squared residual per coordinate and frame is expected, and its variance
    is as large. Outliers (`labels` intp [N] below 0) have 0.
    """
    excess = np.zeros(len(labels))
    expected = np.maximum(evidence.outlier / (_OUTLIER_SHARE * CAP), 1e-9)
    for k in range(evidence.body.shape[1]):
        members = np.flatnonzero(labels == k)
        if len(members):
            cost, usual_cost = evidence.body[members, k], expected[members]
            usual = float(np.median(cost / usual_cost))
            excess[members] = (cost - usual * usual_cost) / np.sqrt(usual_cost)
    return excess


def path_price(dof: int, poses: float, birth: float) -> float:
    """Price of a body and its path of some poses, nat; the static one, of no degree of freedom, has none.

    A nat for each degree of freedom (Akaike 1974), and that of its birth.
    """
    return dof * poses + birth if dof else 0.0


def _residuals(frames: Frames, poses: Floats, rows: Ints, soft: Floats) -> tuple[Floats, Floats]:
    """Cost and mean squared residual of rows [n] under each body of stacked poses, [n, K] each."""
    shape = len(rows), len(poses)
    cost, squared = np.zeros(shape), np.full(shape, np.nan)
    deformation = soft, float(np.exp(-frames.step / _DEFORMATION_TIME))
    unposed = _UNCOVERED_SHARE * CAP * frames.dim
    terms = deformation, unposed, frames.dim, CAP
    body_costs(frames.arrays, rows, poses, *terms, cost, squared)
    return cost, squared


def deformation(frames: Frames, body: Body) -> float:
    """Variance of the deformation of a body under which its own rows are most likely.

    Soft things are bodies too, and deform slowly as they move; what rests does not deform.
    """
    soft, least = 0.0, np.inf
    if body.static:
        return soft
    tried = frames.config.looseness * frames.tolerance[body.rows].mean() * _DEFORMATIONS
    poses = stacked([body])
    # From a rigid body on, as long as they become more likely.
    for variance in np.unique(tried[tried <= _MOST_DEFORMATION**2 * frames.moved[body.rows].mean()]):
        cost, _ = _residuals(frames, poses, body.rows, np.array([variance]))
        paid = float(frames.weight[body.rows] @ cost[:, 0])
        if paid >= least:
            break
        least, soft = paid, float(variance)
    return soft
