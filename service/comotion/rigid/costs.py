"""In rows and bodies, out what each trajectory costs under each body, in nats (step 7)."""

from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..config import RigidConfig
from .kernels.residuals import body_costs
from .procrustes import Body, static_body
from .resampling import Frames
from .sliding import with_sliders

# Charge for a frame in which a body has no pose, as a share of the cap, where it covers little of a
# trajectory: more than that of an outlier, or a body without poses would be the cheapest. Chosen on the
# scenes of docs/research/accuracy.md.
_UNCOVERED_SHARE = 0.7
# Most tolerances that the residual of one row adds to the looseness of its body: a row that does not belong
# must not make it loose. Chosen on the scenes of docs/research/accuracy.md.
_MOST_EXCESS = 9.0
# Share of what rest would gain by a body's tolerance that the body pays. All of it would be fair, but takes
# soft bodies apart that rest most of the time. Chosen on the markers and on stress scenes of even seeds.
_REST_SHARE = 0.5


@dataclass(frozen=True)
class Costs:
    """Costs in nats: `body` float64 [N, K], `outlier` [N], `opening` [K], `restless` [K].

    `restless` is what opening would cost if the body had never rested: what it must gain to move clearly.

    `squared` float64 [P, K] is the mean squared residual of each row, NaN where it was not computed.

    `wider` float64 [K] is the variance by which the tolerance of a body exceeds that of a row; `slides` bool
    [N, K] whether a cost is that of a feature that slides on the body.
    """

    body: Floats
    outlier: Floats
    opening: Floats
    restless: Floats = field(default_factory=lambda: np.zeros(0))
    wider: Floats = field(default_factory=lambda: np.zeros(0))
    slides: Bools = field(default_factory=lambda: np.zeros((0, 0), np.bool_))
    squared: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    def of(self, chosen: list[int]) -> "Costs":
        """The costs of some bodies only, by column."""
        wider = self.wider[chosen] if len(self.wider) else self.wider
        slides = self.slides[:, chosen] if self.slides.size else self.slides
        restless = self.restless[chosen] if len(self.restless) else self.restless
        squared = self.squared[:, chosen] if self.squared.size else self.squared
        prices = self.opening[chosen], restless
        return Costs(self.body[:, chosen], self.outlier, *prices, wider, slides, squared)


def costs(frames: Frames, bodies: list[Body], config: RigidConfig) -> Costs:
    """Cost of each trajectory under each body, of being an outlier, and of opening each body.

    C_ik = 1/2 sum_f min(|x_f - b_i|^2 / v_ik, cap dim), x the trajectory in the body's frame, b_i its robust
    mean there and v_ik the tolerance. Each degree of freedom of a pose gains half a nat by fitting noise
    even where the body does not exist; the price of opening is beyond that.
    """
    poses = stacked(bodies)
    wider = _looseness(frames, bodies, poses, config)
    body, squared = _body_costs(frames, poses, wider, config)
    seen, outlier = _outlier_costs(frames, config)
    opening = np.array([_opening(b, b.free, config) for b in bodies])
    restless = np.array([_opening(b, int(b.posed.sum()), config) for b in bodies])
    body, slides = with_sliders(frames, bodies, body, seen, config)
    return Costs(body, outlier, opening, restless, wider, slides, squared)


def updated(frames: Frames, bodies: list[Body], found: Costs, tracks: Ints, config: RigidConfig) -> Costs:
    """The costs, with those of `tracks` intp [n], ascending, computed anew; all that are new are among them.

    New trajectories are the last ones of `frames`, as are their rows.
    """
    some, rows = frames.of(tracks), frames.rows_of(tracks)
    body, squared = _body_costs(some, stacked(bodies), found.wider, config)
    new, shape = len(frames.key) - len(found.outlier), (len(frames.owner), len(bodies))
    every = replace(
        found,
        body=np.concatenate([found.body, np.zeros((new, len(bodies)))]),
        outlier=np.append(found.outlier, np.zeros(new)),
        slides=np.concatenate([found.slides, np.zeros((new, len(bodies)), np.bool_)]),
        squared=np.concatenate([found.squared, np.zeros((shape[0] - len(found.squared), shape[1]))]),
    )
    every.body[tracks], every.squared[rows] = body, squared
    every.outlier[tracks], every.slides[tracks] = _outlier_costs(some, config)[1], False
    return every


def _body_costs(frames: Frames, poses: Floats, wider: Floats, config: RigidConfig) -> tuple[Floats, Floats]:
    """Cost of each trajectory, float64 [N, K], and mean squared residual of each row, [P, K]."""
    rows = np.arange(len(frames.owner))
    at_rest = np.zeros((len(rows), len(poses)))
    row_costs, squared = _residuals(frames, poses, rows, wider, config, at_rest)
    # The deformation of a body is alike from frame to frame: its price is paid once, not at each frame.
    price = 0.5 * frames.dim * np.log1p(wider / frames.tolerance[:, None])
    # A wider tolerance lowers all costs. A body must not earn by it what rest would earn as well.
    row_costs += price + _REST_SHARE * np.maximum(at_rest - price, 0.0)
    return np.stack([frames.per_track(one) for one in row_costs.T], 1), squared


def _outlier_costs(frames: Frames, config: RigidConfig) -> tuple[Floats, Floats]:
    """Frames in which each trajectory is observed, and its cost as an outlier, float64 [N] each."""
    seen = frames.per_track((frames.w > 0).sum(1).astype(np.float64))
    return seen, 0.5 * config.outlier_share * config.residual_cap * frames.dim * seen


def excess_costs(evidence: Costs, labels: Ints, config: RigidConfig) -> Floats:
    """By how much the cost of each trajectory exceeds what is usual in its hypothesis, float64 [N].

    In standard deviations: half a squared residual per coordinate and frame is expected, and its variance
    is as large. Outliers (`labels` intp [N] below 0) have 0.
    """
    found = np.zeros(len(labels))
    expected = np.maximum(evidence.outlier / (config.outlier_share * config.residual_cap), 1e-9)
    for k in range(evidence.body.shape[1]):
        members = np.flatnonzero(labels == k)
        if len(members):
            cost, due = evidence.body[members, k], expected[members]
            usual = float(np.median(cost / due))
            found[members] = (cost - usual * due) / np.sqrt(due)
    return found


def moving_bodies(frames: Frames, bodies: list[Body], found: Costs, config: RigidConfig) -> list[int]:
    """Columns of the static body and of the bodies that are worth their price by their motion alone.

    Such a body explains its own rows better than rest does, both at its own tolerance, by more than its
    price. A wider tolerance lowers the cost of all trajectories: among very many at rest, a body could be
    worth its price by its tolerance alone.
    """
    kept = []
    for k, body in enumerate(bodies):
        if body.static:
            kept.append(k)
            continue
        own = np.unique(frames.owner[body.rows])
        v = float(frames.tolerance[body.rows].min())
        # A bound that needs no residuals: a wider tolerance lowers a cost in proportion at most.
        least = found.body[own, 0].sum() * v / (v + found.wider[k]) - found.body[own, k].sum()
        if least > found.opening[k] or _gain(frames, body, found.wider[k], config) > found.opening[k]:
            kept.append(k)
    return kept


def pose_costs(dof: int, poses: float, config: RigidConfig) -> float:
    """Price of so many poses, nat."""
    return 0.5 * dof * (1 + config.pose_price) * poses


def _opening(body: Body, poses: float, config: RigidConfig) -> float:
    """Price of a body: of so many poses, and of being one more."""
    if body.static:
        return 0.0
    return pose_costs(body.dof, poses, config) + config.birth_price


def _gain(frames: Frames, body: Body, wider: float, config: RigidConfig) -> float:
    """By how much a body's own rows are cheaper under it than at rest, both at its tolerance."""
    both = stacked([static_body(len(frames.stamps)), body])
    cost, _ = _residuals(frames, both, body.rows, np.full(2, wider), config)
    return float((cost[:, 0] - cost[:, 1]) @ frames.weight[body.rows])


def _residuals(
    frames: Frames,
    poses: Floats,
    rows: Ints,
    wider: Floats,
    config: RigidConfig,
    at_rest: Floats | None = None,
) -> tuple[Floats, Floats]:
    """Cost and mean squared residual of rows [n] under each body of :func:`stacked` poses, [n, K] each.

    `at_rest` [n, K]: out, as of :func:`~.kernels.residuals.body_costs`.
    """
    shape = len(rows), len(poses)
    cost, squared = np.zeros(shape), np.full(shape, np.nan)
    gain = np.zeros((0, 0)) if at_rest is None else at_rest
    unposed = _UNCOVERED_SHARE * config.residual_cap * frames.dim
    terms = wider, unposed, frames.dim, config.residual_cap
    body_costs(frames.arrays, rows, poses, *terms, cost, squared, gain)
    return cost, squared


def stacked(bodies: list[Body]) -> Floats:
    """Poses of K bodies as kernels of costs take them, float64 [K, F, 13].

    Each is R row by row, t, and whether the frame has a pose: 1 or 0.
    """
    found = np.empty((len(bodies), len(bodies[0].t), 13))
    for k, body in enumerate(bodies):
        found[k, :, :9], found[k, :, 9:12] = body.R.reshape(-1, 9), body.t
        found[k, :, 12] = body.posed
    return found


def _looseness(frames: Frames, bodies: list[Body], poses: Floats, config: RigidConfig) -> Floats:
    """Variance that each body, with its :func:`stacked` poses, adds to the tolerance, [K].

    Soft things are bodies too. A body that fits its own rows worse than the noise says has a wider
    tolerance, for all trajectories alike, at the price of a log per coordinate.
    """
    wider = np.zeros(len(bodies))
    for k, body in enumerate(bodies):
        if not body.static:
            tolerance = frames.tolerance[body.rows]
            _, squared = _residuals(frames, poses[k : k + 1], body.rows, np.zeros(1), config)
            excess = np.minimum(squared[:, 0] / (frames.dim * tolerance), _MOST_EXCESS).mean()
            wider[k] = max(config.looseness * (excess - 1), 0.0) * tolerance.mean()
    return wider
