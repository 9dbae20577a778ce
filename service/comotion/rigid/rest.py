"""In a body, out the same on a smooth path, with one pose for each rest of it (step 6).

A body has a pose in each frame, also while it rests. Those poses fit the noise of whatever takes part in the
fit, so that a resting feature next to nothing of the body may cost less under it than at rest. With one pose
for each rest, both cost the same, and place and memory decide; and a rest has the price of one pose.

Between rests a body moves smoothly. Poses that were free in each frame would fit noise there as well, and be
paid for; a smooth path has the price of a line, and of what it bends.
"""

from dataclasses import replace

import numpy as np

from ..arrays import Floats
from ..config import RigidConfig
from .frames import Frames
from .kernels.paths import smooth_poses
from .kernels.rest import settle
from .procrustes import Body

# s that a rest takes at least.
_LEAST_REST = 0.5


def settled(frames: Frames, body: Body, config: RigidConfig) -> Body:
    """The body with one pose for each rest, and a smooth path between them."""
    if body.static or not body.posed.any():
        return body
    still = replace(body, R=body.R.copy(), t=body.t.copy())
    w = np.ascontiguousarray(frames.w[body.rows].T)
    # Not the tolerance: what moves slowly, within its slack, does not rest.
    noise = 1 / frames.noise[body.rows], frames.metric[body.rows]
    template, rests = np.ascontiguousarray(body.template.T), np.zeros(len(body.t), np.bool_)
    least = _LEAST_REST * config.frame_rate
    runs = settle(w, *noise, template, frames.dim, body.dof, least, still.poses, rests)
    free, nats = smooth_poses(*_holds(frames, body), body.posed & ~rests, frames.dim, still.poses)
    return replace(still, free=runs + free, bends=nats, rests=bool(rests[-1]))


def _holds(frames: Frames, body: Body) -> tuple[Floats, Floats, Floats]:
    """The middle of a body, [3], and how well its rows hold that and an angle, inverse variances [F] each."""
    rows = body.rows
    weight = frames.w[rows] * (frames.weight[rows] / frames.tolerance[rows])[:, None]
    middle = weight.sum(1) @ body.template / weight.sum()
    # An angle about an axis is held by the distances from that axis: in 3-D by two of three squares.
    squared = ((body.template - middle) ** 2).sum(1) * (2 / 3 if frames.dim == 3 else 1.0)
    return middle, weight.sum(0), squared @ weight
