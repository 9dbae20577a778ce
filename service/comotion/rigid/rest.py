"""In bodies and their costs, out costs that do not depend on the noise of poses at rest (for step 9).

A body has a pose in each frame, also while it rests. Those poses fit the noise of whatever takes part in the
fit, so that a resting feature next to nothing of the body may cost less under it than at rest. With one pose
for each rest, both cost the same, and place and memory decide.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats
from ..config import RigidConfig
from .costs import Costs, costs
from .kernels.rest import settle
from .procrustes import Body
from .resampling import Frames


@dataclass(frozen=True)
class Settled:
    """Costs with one pose for each rest of a body.

    `cost` float64 [N, K], nat; `resting` bool [K], whether a body rests in the newest frame, False for the
    static one.
    """

    cost: Floats
    resting: Bools


def settled_costs(
    frames: Frames, bodies: list[Body], evidence: Costs, config: RigidConfig, stride: int
) -> Settled:
    """Compute the costs of bodies that rest anew, with one pose for each rest.

    Parameters
    ----------
    evidence
        Costs with a pose in each frame.
    stride
        As of :func:`~comotion.rigid.costs.costs`.
    """
    cost, resting = evidence.body.copy(), np.zeros(len(bodies), np.bool_)
    changed, at = [], []
    for k, body in enumerate(bodies):
        still, rests = _settled(frames, body)
        if rests.any():
            changed.append(still)
            at.append(k)
            resting[k] = rests[-1]
    if changed:
        cost[:, at] = costs(frames, changed, config, stride=stride).body
    return Settled(cost, resting)


def _settled(frames: Frames, body: Body) -> tuple[Body, Bools]:
    """The body with one pose for each rest, and in which frames it rests, bool [F]."""
    rests = np.zeros(len(frames.stamps), np.bool_)
    if body.static:
        return body, rests
    still = replace(body, R=body.R.copy(), t=body.t.copy())
    w = np.ascontiguousarray(frames.w[body.rows].T)
    # Not the tolerance: what moves slowly, within its slack, does not rest.
    inverse = 1 / frames.noise[body.rows]
    template = np.ascontiguousarray(body.template.T)
    noise = inverse, frames.metric[body.rows]
    settle(w, *noise, template, frames.dim, body.dof, still.poses, rests)
    return still, rests
