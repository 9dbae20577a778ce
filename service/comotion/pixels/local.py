"""Local motions: affine displacement fields of neighbouring trajectories (METHOD-pixels step 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .keyframes import Floats32, FramePairs
from .sampling import Indices

_LEAST_MEMBERS = 4


@dataclass(frozen=True)
class Residuals:
    """How H local motions explain N trajectories over Q frame pairs.

    Attributes
    ----------
    total
        float32 [H, N], px²; sum of the capped squared residuals.
    used
        float32 [H, Q]; 1 where a motion could be fitted.
    activity
        float64 [Q], 0..1; how much goes on in a frame pair.
    """

    total: Floats32
    used: Floats32
    activity: NDArray[np.float64]


def explain(pairs: FramePairs, groups: list[Indices], ridge: float, cap: float) -> Residuals:
    """Fit every group's motion in every frame pair and apply it to all trajectories.

    Parameters
    ----------
    pairs
        Frame pairs of N trajectories.
    groups
        Members of local motions, each intp [H_r, M_r].
    ridge, cap
        px²; see :class:`~comotion.pixels.parameters.PixelParameters`.
    """
    parts = [_explain(pairs.start, pairs.move, pairs.seen, g, ridge, np.float32(cap)) for g in groups]
    weights = [len(g) for g in groups]
    activity = np.average([part[2] for part in parts], axis=0, weights=weights)
    return Residuals(
        np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]), activity
    )


@compiled(fastmath=True)
def _fit(
    start: Floats32, move: Floats32, seen: Floats32, members: Indices, ridge: float
) -> tuple[int, float, float, float, float, float, float]:
    """Centred least squares with a ridge: u = a x + b y + e, v = c x + d y + f; (n, a, b, c, d, e, f)."""
    n = 0
    cx = cy = cu = cv = 0.0
    for i in members:
        if seen[i] > 0:
            n += 1
            cx += start[0, i]
            cy += start[1, i]
            cu += move[0, i]
            cv += move[1, i]
    if n < _LEAST_MEMBERS:
        return n, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    cx, cy, cu, cv = cx / n, cy / n, cu / n, cv / n
    sxx = syy = n * ridge
    sxy = sxu = syu = sxv = syv = 0.0
    for i in members:
        if seen[i] > 0:
            px, py, pu, pv = start[0, i] - cx, start[1, i] - cy, move[0, i] - cu, move[1, i] - cv
            sxx += px * px
            syy += py * py
            sxy += px * py
            sxu += px * pu
            syu += py * pu
            sxv += px * pv
            syv += py * pv
    det = sxx * syy - sxy * sxy
    a, b = (sxu * syy - syu * sxy) / det, (syu * sxx - sxu * sxy) / det
    c, d = (sxv * syy - syv * sxy) / det, (syv * sxx - sxv * sxy) / det
    return n, a, b, c, d, cu - a * cx - b * cy, cv - c * cx - d * cy


@compiled(fastmath=True)
def _explain(
    start: Floats32, move: Floats32, seen: Floats32, members: Indices, ridge: float, cap: np.float32
) -> tuple[Floats32, Floats32, NDArray[np.float64]]:
    pairs, _, count = start.shape
    total = np.zeros((len(members), count), np.float32)
    used = np.zeros((len(members), pairs), np.float32)
    activity = np.zeros(pairs, np.float64)
    weight = np.zeros(pairs, np.float64)
    for q in range(pairs):
        x, y, u, v, m = start[q, 0], start[q, 1], move[q, 0], move[q, 1], seen[q]
        visible = m.sum()
        for h in range(len(members)):
            n, a_, b_, c_, d_, e_, f_ = _fit(start[q], move[q], m, members[h], ridge)
            if n < _LEAST_MEMBERS:
                continue
            a, b, c = np.float32(a_), np.float32(b_), np.float32(c_)
            d, e, f = np.float32(d_), np.float32(e_), np.float32(f_)
            used[h, q] = np.float32(1)
            row = total[h]
            active = np.float32(0)
            for i in range(count):
                ru = u[i] - a * x[i] - b * y[i] - e
                rv = v[i] - c * x[i] - d * y[i] - f
                r = min((ru * ru + rv * rv) * m[i], cap)
                row[i] += r
                active += r / (r + np.float32(1))
            activity[q] += active
            weight[q] += visible
    return total, used, activity / np.maximum(weight, 1)
