"""Gives a body one pose for each of its rests, so that its poses do not fit noise (step 6).

A body has a pose in each frame, also while it rests. Those poses fit the noise of the rows that the body was
fitted to, so that a resting feature that is no part of the body may cost less under it than at rest. With one
pose for each rest, both costs are the same, and position and memory decide; and a rest has the price of one
pose. A body that moves slowly rests for a few frames at a time: it has as many poses as its noise lets tell
apart.
"""

from dataclasses import replace

import numpy as np

from ..config import RigidConfig
from .frames import Frames
from .kernels.rest import settle
from .procrustes import Body

# s that a rest takes at least; of .5 and .2, chosen on stress scenes of seed 1.
_LEAST_REST = 0.2


def settled(frames: Frames, body: Body, config: RigidConfig) -> Body:
    """The body with one pose for each rest."""
    if body.static or not body.posed.any():
        return body
    still = replace(body, R=body.R.copy(), t=body.t.copy())
    w = np.ascontiguousarray(frames.w[body.rows].T)
    # Not the tolerance: a body that moves slowly, within its slack, does not rest.
    noise = 1 / frames.noise[body.rows], frames.metric[body.rows]
    template, rests = np.ascontiguousarray(body.template.T), np.zeros(len(body.t), np.bool_)
    least = _LEAST_REST * config.frame_rate
    runs = settle(w, *noise, template, frames.dim, body.dof, least, still.poses, rests)
    moving = int(np.count_nonzero(body.posed & ~rests))
    return replace(still, free=runs + moving, rests=bool(rests[-1]))
