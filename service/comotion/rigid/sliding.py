"""Lowers the costs of features that slide along a line on a body (step 7).

A corner where an edge of a body meets the background slides along the edge as the view turns. Several such
features often move alike, and would make a body of their own. A slider has one degree of freedom per frame
in the frame of its body, which costs a nat as those of a pose do.
"""

import numpy as np

from ..arrays import Bools, Floats, Ints, thinned
from ..geometry.body import Body
from ..geometry.frames import DRAWN, FEW, SETTLED, Frames
from .costs import CAP

# Most that a feature slides, rms, in rms radii of its host. Chosen on stress scenes of even seeds, so that
# the markers keep their figures.
_REACH = 0.5


def with_sliders(frames: Frames, bodies: list[Body], body: Floats, seen: Floats) -> tuple[Floats, Bools]:
    """Costs of trajectories that no larger body explains, lowered to those of sliding where that is less.

    Parameters
    ----------
    body, seen
        float64 [N, K], costs in nats, and [N], frames in which each trajectory is observed.

    Returns
    -------
    Costs, float64 [N, K], and where they are those of sliding, bool [N, K].
    """
    # Sliding on a body at rest would be sliding on the static one, which is no host.
    owners = [len(np.unique(frames.owner[host.rows])) for host in bodies]
    hosts = [k for k, host in enumerate(bodies) if host.free > 1 and owners[k] > FEW]
    rows = _unexplained(frames, bodies, hosts, body, seen)
    if not len(rows):
        return body, np.zeros(body.shape, np.bool_)
    tracks, costs = frames.owner[rows], body.copy()
    for k in hosts:
        costs[tracks, k] = np.minimum(body[tracks, k], _slides(frames, bodies[k], rows))
    return costs, costs < body


def _unexplained(frames: Frames, bodies: list[Body], hosts: list[int], body: Floats, seen: Floats) -> Ints:
    """Rows of long trajectories of points that neither rest nor a host explains, intp [n]."""
    large = [k for k, candidate in enumerate(bodies) if candidate.static or k in hosts]
    # A slider is expected to cost a nat, and half of one for each coordinate that is left.
    due = 0.5 * (frames.dim + 1) * seen
    # Bodies that begin to move slide on each other at first.
    unexplained = (body[:, large] > due[:, None]).all(1) & (seen >= SETTLED * frames.config.frame_rate)
    unexplained &= np.bincount(frames.owner, minlength=len(seen)) == 1
    return frames.rows_of(thinned(np.flatnonzero(unexplained), DRAWN))


def _slides(frames: Frames, host: Body, rows: Ints) -> Floats:
    """Cost of each row as a slider on a body, float64 [n], nat; inf where it cannot be one."""
    seen, w = (frames.w[rows] > 0).sum(1), frames.w[rows] * host.posed
    held, cap = (w > 0).sum(1), CAP * frames.dim
    x = np.ascontiguousarray(((frames.y[rows] - host.t).swapaxes(0, 1) @ host.R).swapaxes(0, 1))
    total = np.maximum(w.sum(1), 1e-300)
    x -= w[:, None] @ x / total[:, None, None]
    line = np.linalg.eigh((w[:, :, None] * x).transpose(0, 2, 1) @ x)[1][:, :, -1]
    along = (x @ line[:, :, None])[:, :, 0]
    across = w * np.maximum(np.einsum("nfi,nfi->nf", x, x) - along**2, 0.0)
    paid = np.minimum(across / frames.noise[rows, None], cap).sum(1)
    cost = 0.5 * (paid + cap * (seen - held)) + held
    radius = ((host.template - host.template.mean(0)) ** 2).sum(1).mean()
    near = (w * along**2).sum(1) / total <= _REACH**2 * radius
    return np.where(near & (held >= SETTLED * frames.config.frame_rate), cost, np.inf)
