"""Rigid bodies: a motion over the frames, fitted to some trajectories, and what it costs each of all."""

from dataclasses import dataclass

import numpy as np

from ..window import Bools, Floats
from .config import MotionConfig
from .frames import Frames
from .procrustes import body_costs, fit_body
from .tracks import Ints

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
    """Costs in nats: `body` float64 [N, K], `outlier` [N], `opening` [K]."""

    body: Floats
    outlier: Floats
    opening: Floats


def costs(
    frames: Frames, bodies: list[Body], config: MotionConfig, stretch: float = 1.0, stride: int = 1
) -> Costs:
    """Cost of each trajectory under each body, of being an outlier, and of opening each body.

    C_ik = 1/2 sum_f min(|y_body - b_i|^2 / v_ik, cap dim), y_body the trajectory in the body's frame
    and b_i its robust mean. A degree of freedom gains half a nat by fitting noise, whatever it is worth;
    its price is beyond that. `stretch` scales costs of thinned frames to those of all. With a `stride` above
    1 the costs of motions far from the best are estimates.
    """
    rows = np.arange(len(frames.owner))
    wider = np.array([_widening(frames, body, config) for body in bodies])
    unposed = np.array([_unposed_charge(frames, body, config) for body in bodies])
    found, _ = _residuals(frames, bodies, rows, wider, unposed, config, stride)
    wide = frames.tolerance[:, None] + wider
    found += 0.5 * _LOOSE_PRICE * frames.dim * np.log(wide / frames.tolerance[:, None])
    body = np.stack([frames.per_track(one) for one in found.T], 1) * stretch
    seen = frames.per_track((frames.w > 0).sum(1).astype(np.float64))
    outlier = 0.5 * config.outlier_share * config.residual_cap * frames.dim * seen * stretch
    opening = np.array([_opening(b, config, stretch) for b in bodies])
    return Costs(body, outlier, opening)


def _opening(body: Body, config: MotionConfig, stretch: float) -> float:
    if body.static:
        return 0.0
    poses = 0.5 * body.dof * (1 + config.pose_price) * stretch * int(body.posed.sum())
    return poses + config.birth_price


def moves(frames: Frames, body: Body, config: MotionConfig) -> bool:
    """Whether a body explains its own rows so much better than rest, both at its tolerance, as it costs.

    A wider tolerance suits everybody: among very many at rest, a body could live on that alone.
    """
    wider = np.full(2, _widening(frames, body, config))
    both = [static_body(len(frames.stamps)), body]
    unposed = np.array([0.0, _unposed_charge(frames, body, config)])
    cost, _ = _residuals(frames, both, body.rows, wider, unposed, config)
    return float((cost[:, 0] - cost[:, 1]) @ frames.weight[body.rows]) > _opening(body, config, 1.0)


def residuals(frames: Frames, body: Body, rows: Ints, config: MotionConfig) -> Floats:
    """Mean squared residual of rows [n] under a body, float64 [n]."""
    return _residuals(frames, [body], rows, np.zeros(1), np.zeros(1), config)[1][:, 0]


def _residuals(
    frames: Frames,
    bodies: list[Body],
    rows: Ints,
    wider: Floats,
    unposed: Floats,
    config: MotionConfig,
    stride: int = 1,
) -> tuple[Floats, Floats]:
    """Cost and mean squared residual of rows [n] under each body, [n, K] each."""
    cost, squared = np.zeros((len(rows), len(bodies))), np.zeros((len(rows), len(bodies)))
    count = len(frames.stamps)
    R = np.stack([body.R.reshape(count, 9).T for body in bodies])
    t = np.stack([body.t.T for body in bodies])
    posed = np.array([body.posed for body in bodies], np.float64)
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


def _unposed_charge(frames: Frames, body: Body, config: MotionConfig) -> float:
    if body.static:
        return 0.0
    seen = frames.w[body.rows] > 0
    covered = float(seen[:, body.posed].sum()) / max(1, int(seen.sum()))
    return frames.dim * (1.0 if covered >= _COVERED else _UNCOVERED * config.residual_cap)


def _widening(frames: Frames, body: Body, config: MotionConfig) -> float:
    """By how much a body's tolerance exceeds that of its noise: it follows its members' residual.

    Soft things are bodies too: a body that fits its own members worse than the noise says is given
    a wider tolerance, for all trajectories alike, at the price of a log per coordinate.
    """
    if body.static:
        return 0.0
    own = frames.tolerance[body.rows]
    squared = residuals(frames, body, body.rows, config)
    excess = float(np.minimum(squared / (own * frames.dim), _LOOSEST).mean())
    return max(config.looseness * (min(excess, _LOOSEST) - 1), 0.0) * float(own.mean())
