"""Rigid bodies: a motion over the frames, fitted to some trajectories, and what it costs each of all."""

from dataclasses import dataclass, field

import numpy as np

from ..arrays import Bools, Floats, Ints
from ..config import RigidConfig
from .frames import Frames
from .procrustes import fit_body
from .residuals import body_costs, own_residuals

FIT_ITERATIONS = 4
# A body that is posed in most of its members' frames is charged the expected residual for the rest;
# one that is not would win by being empty.
_COVERED = 0.6
_UNCOVERED = 0.7
# Members that fit worse than this many tolerances say nothing of their body.
_LOOSEST = 9.0
# Deformation is alike from frame to frame: looseness is paid once, not at each frame.
_LOOSE_PRICE = 1.5


@dataclass(frozen=True)
class Body:
    """A candidate: poses x = R b + t over F frames.

    Attributes
    ----------
    rows
        intp [m], rows that it was fitted to; empty for the static body.
    template
        float64 [m, 3], body coordinates of the rows.
    R, t, posed
        float64 [F, 3, 3], float64 [F, 3], bool [F].
    dof
        Degrees of freedom of a pose: 3 in 2-D, 6 in 3-D, 5 for a pair in 3-D, 0 for the static one.
    """

    rows: Ints
    template: Floats
    R: Floats
    t: Floats
    posed: Bools
    dof: int

    @property
    def static(self) -> bool:
        """Whether it is the body that never moves."""
        return self.dof == 0


def static_body(count: int) -> Body:
    """The body at rest over `count` frames."""
    nothing = np.zeros(0, np.intp)
    turns = np.tile(np.eye(3), (count, 1, 1))
    return Body(nothing, np.zeros((0, 3)), turns, np.zeros((count, 3)), np.ones(count, np.bool_), 0)


def fit(frames: Frames, rows: Ints) -> Body:
    """Fit a body to rows: generalised Procrustes with missing data and robust weights."""
    count = len(frames.stamps)
    w = frames.w[rows]
    R = np.tile(np.eye(3), (count, 1, 1))
    t = np.zeros((count, 3))
    posed = np.zeros(count, np.bool_)
    template = np.zeros((3, len(rows)))
    # The kernel runs along the rows of a frame.
    y = np.ascontiguousarray(frames.y[rows].transpose(1, 2, 0))
    inverse = 1 / frames.tolerance[rows]
    fit_body(y, np.ascontiguousarray(w.T), inverse, frames.dim, FIT_ITERATIONS, template, R, t, posed)
    pair = int((w > 0).any(1).sum()) <= 2
    dof = 3 if frames.dim == 2 else (5 if pair else 6)
    return Body(rows, np.ascontiguousarray(template.T), R, t, posed, dof)


@dataclass(frozen=True)
class Costs:
    """Costs in nats: `body` float64 [N, K], `outlier` [N], `opening` [K].

    `wider` float64 [K] says by how much a body's tolerance exceeds that of its noise.
    """

    body: Floats
    outlier: Floats
    opening: Floats
    wider: Floats = field(default_factory=lambda: np.zeros(0))

    def of(self, chosen: list[int]) -> "Costs":
        """Those of some bodies."""
        wider = self.wider[chosen] if len(self.wider) else self.wider
        return Costs(self.body[:, chosen], self.outlier, self.opening[chosen], wider)


def costs(
    frames: Frames, bodies: list[Body], config: RigidConfig, stretch: float = 1.0, stride: int = 1
) -> Costs:
    """Cost of each trajectory under each body, of being an outlier, and of opening each body.

    C_ik = 1/2 sum_f min(|y_body - b_i|^2 / v_ik, cap dim), y_body the trajectory in the body's frame
    and b_i its robust mean. A degree of freedom gains half a nat by fitting noise, whatever it is worth;
    its price is beyond that. `stretch` scales costs of thinned frames to those of all. With a `stride` above
    1 the costs of motions far from the best are estimates.
    """
    rows = np.arange(len(frames.owner))
    wider, unposed = _own_terms(frames, bodies, config)
    found, _ = _residuals(frames, bodies, rows, wider, unposed, config, stride)
    wide = frames.tolerance[:, None] + wider
    found += 0.5 * _LOOSE_PRICE * frames.dim * np.log(wide / frames.tolerance[:, None])
    body = np.stack([frames.per_track(one) for one in found.T], 1) * stretch
    seen = frames.per_track((frames.w > 0).sum(1).astype(np.float64))
    outlier = 0.5 * config.outlier_share * config.residual_cap * frames.dim * seen * stretch
    opening = np.array([_opening(b, config, stretch) for b in bodies])
    return Costs(body, outlier, opening, wider)


def _opening(body: Body, config: RigidConfig, stretch: float) -> float:
    if body.static:
        return 0.0
    poses = 0.5 * body.dof * (1 + config.pose_price) * stretch * int(body.posed.sum())
    return poses + config.birth_price


def moving(frames: Frames, bodies: list[Body], found: Costs, config: RigidConfig) -> list[int]:
    """The static body and those that explain their own rows so much better, at one tolerance, as they cost.

    A wider tolerance suits everybody: among very many at rest, a body could live on that alone.
    """
    kept = [k for k, body in enumerate(bodies) if body.static]
    for k, body in enumerate(bodies):
        if body.static:
            continue
        own = np.unique(frames.owner[body.rows])
        v = float(frames.tolerance[body.rows].min())
        # A wider tolerance makes no cost smaller than in proportion.
        least = found.body[own, 0].sum() * v / (v + found.wider[k]) - found.body[own, k].sum()
        if least > found.opening[k] or _gain(frames, body, found.wider[k], config) > found.opening[k]:
            kept.append(k)
    return kept


def _gain(frames: Frames, body: Body, wider: float, config: RigidConfig) -> float:
    """By how much a body's own rows are cheaper under it than at rest, both at its tolerance."""
    both = [static_body(len(frames.stamps)), body]
    _, unposed = _own_terms(frames, both, config)
    cost, _ = _residuals(frames, both, body.rows, np.full(2, wider), unposed, config)
    return float((cost[:, 0] - cost[:, 1]) @ frames.weight[body.rows])


def residuals(frames: Frames, body: Body, rows: Ints, config: RigidConfig) -> Floats:
    """Mean squared residual of rows [n] under a body, float64 [n]."""
    return _residuals(frames, [body], rows, np.zeros(1), np.zeros(1), config)[1][:, 0]


def _residuals(
    frames: Frames,
    bodies: list[Body],
    rows: Ints,
    wider: Floats,
    unposed: Floats,
    config: RigidConfig,
    stride: int = 1,
) -> tuple[Floats, Floats]:
    """Cost and mean squared residual of rows [n] under each body, [n, K] each."""
    cost, squared = np.zeros((len(rows), len(bodies))), np.zeros((len(rows), len(bodies)))
    R, t, posed = _stacked(bodies)
    body_costs(
        frames.y,
        frames.w,
        frames.tolerance,
        rows,
        wider,
        frames.dim,
        config.residual_cap,
        R,
        t,
        posed,
        unposed,
        stride,
        cost,
        squared,
    )
    return cost, squared


def _stacked(bodies: list[Body]) -> tuple[Floats, Floats, Floats]:
    """Poses as the kernels read them, [K, 9, F], [K, 3, F] and [K, F] (1: posed)."""
    count = len(bodies[0].t)
    R = np.stack([body.R.reshape(count, 9).T for body in bodies])
    t = np.stack([body.t.T for body in bodies])
    return R, t, np.array([body.posed for body in bodies], np.float64)


def _own_terms(frames: Frames, bodies: list[Body], config: RigidConfig) -> tuple[Floats, Floats]:
    """By how much each body's tolerance exceeds that of its noise, and the charge for a frame without pose.

    Soft things are bodies too: a body that fits its own members worse than the noise says is given
    a wider tolerance, for all trajectories alike, at the price of a log per coordinate.
    """
    first = np.cumsum([0, *(len(body.rows) for body in bodies)])
    rows = np.concatenate([body.rows for body in bodies])
    excess, covered = np.zeros(len(bodies)), np.zeros(len(bodies))
    own_residuals(
        frames.y,
        frames.w,
        frames.tolerance,
        rows,
        first,
        frames.dim,
        _LOOSEST,
        *_stacked(bodies),
        excess,
        covered,
    )
    static = np.array([body.static for body in bodies])
    owners = np.repeat(np.arange(len(bodies)), np.diff(first))
    mean = np.bincount(owners, frames.tolerance[rows], len(bodies)) / np.maximum(np.diff(first), 1)
    wider = np.maximum(config.looseness * (np.minimum(excess, _LOOSEST) - 1), 0.0) * mean
    unposed = np.where(covered >= _COVERED, 1.0, _UNCOVERED * config.residual_cap) * frames.dim
    return np.where(static, 0.0, wider), np.where(static, 0.0, unposed)
