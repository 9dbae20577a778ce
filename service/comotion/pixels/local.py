"""Local motions: affine displacement fields of neighbouring trajectories (METHOD-pixels step 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .keyframes import Floats32, FramePairs
from .sampling import Indices

Floats = NDArray[np.float64]

_LEAST_MEMBERS = 4
# Motions differ little in when they see something happen: some of them tell it.
_ACTIVITY_STEP = 8
# Products may be fused into sums; what must not happen is that sums are reordered, see compiled.
_FUSED = {"contract", "nnan", "nsz"}


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
    activity: Floats


def explain(pairs: FramePairs, groups: list[Indices], ridge: float, cap: float) -> Residuals:
    """Fit every group's motion in every frame pair and apply it to all trajectories.

    Parameters
    ----------
    pairs
        Frame pairs of N trajectories.
    groups
        Members of local motions, each intp [H_r, M_r].
    ridge, cap
        px²; see :class:`~comotion.config.PixelsConfig`.
    """
    parts = [_fit(pairs.start, pairs.move, pairs.seen, group.T, ridge) for group in groups]
    motions, used = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    described = pairs.start, pairs.move, pairs.seen, motions, used * np.float32(cap)
    return Residuals(_total_residuals(*described), np.ascontiguousarray(used.T), _activity(*described))


@compiled()
def _fit(
    start: Floats32, move: Floats32, seen: Floats32, members: Indices, ridge: float
) -> tuple[Floats32, Floats32]:
    """Centred least squares with a ridge, for members [M, H] of H motions at a time.

    u = a x + b y + e, v = c x + d y + f; returns (a, b, c, d, e, f) [Q, H, 6] and whether enough
    members were seen, 1 or 0, [Q, H].
    """
    size, count = members.shape
    motions = np.zeros((len(seen), count, 6), np.float32)
    used = np.zeros((len(seen), count), np.float32)
    x, y, u, v, w = np.empty((5, size, count), np.float32)
    for q in range(len(seen)):
        # Gathered first: the sums below then go over contiguous numbers.
        for m in range(size):
            for h in range(count):
                i = members[m, h]
                x[m, h], y[m, h], w[m, h] = start[q, 0, i], start[q, 1, i], seen[q, i]
                u[m, h], v[m, h] = move[q, 0, i], move[q, 1, i]
        sums = np.zeros((5, count))
        _first_moments(x, y, u, v, w, sums)
        moments = np.zeros((7, count))
        _second_moments(x, y, u, v, w, sums, moments)
        _solve(sums, moments, ridge, motions[q], used[q])
    return motions, used


@compiled()
def _first_moments(x: Floats32, y: Floats32, u: Floats32, v: Floats32, w: Floats32, sums: Floats) -> None:
    """Number and means, [5, H]."""
    n, cx, cy, cu, cv = sums
    for m in range(len(x)):
        for h in range(len(n)):
            n[h] += w[m, h]
            cx[h] += x[m, h]
            cy[h] += y[m, h]
            cu[h] += u[m, h]
            cv[h] += v[m, h]
    for h in range(len(n)):
        count = max(n[h], 1.0)
        cx[h], cy[h], cu[h], cv[h] = cx[h] / count, cy[h] / count, cu[h] / count, cv[h] / count


@compiled()
def _second_moments(
    x: Floats32, y: Floats32, u: Floats32, v: Floats32, w: Floats32, sums: Floats, moments: Floats
) -> None:
    """Sums of xx, yy, xy, xu, yu, xv and yv about the means, [7, H]."""
    _, cx, cy, cu, cv = sums
    xx, yy, xy, xu, yu, xv, yv = moments
    for m in range(len(x)):
        for h in range(len(cx)):
            px, py = (x[m, h] - cx[h]) * w[m, h], (y[m, h] - cy[h]) * w[m, h]
            pu, pv = u[m, h] - cu[h], v[m, h] - cv[h]
            xx[h] += px * px
            yy[h] += py * py
            xy[h] += px * py
            xu[h] += px * pu
            yu[h] += py * pu
            xv[h] += px * pv
            yv[h] += py * pv


@compiled()
def _solve(sums: Floats, moments: Floats, ridge: float, motions: Floats32, used: Floats32) -> None:
    for h in range(len(motions)):
        n, cx, cy, cu, cv = sums[:, h]
        if n < _LEAST_MEMBERS:
            continue
        xx, yy, xy, xu, yu, xv, yv = moments[:, h]
        xx, yy = xx + n * ridge, yy + n * ridge
        det = xx * yy - xy * xy
        a, b = (xu * yy - yu * xy) / det, (yu * xx - xu * xy) / det
        c, d = (xv * yy - yv * xy) / det, (yv * xx - xv * xy) / det
        motions[h, 0], motions[h, 1], motions[h, 4] = a, b, cu - a * cx - b * cy
        motions[h, 2], motions[h, 3], motions[h, 5] = c, d, cv - c * cx - d * cy
        used[h] = 1


@compiled(fastmath=_FUSED)
def _total_residuals(
    start: Floats32, move: Floats32, seen: Floats32, motions: Floats32, caps: Floats32
) -> Floats32:
    """Sums of squared residuals of motions [Q, H, 6], each capped (0: the motion does not count), [H, N]."""
    pairs, count, _ = motions.shape
    total = np.zeros((count, start.shape[2]), np.float32)
    # Two at a time: what takes the time is to fetch the trajectories. An odd last one goes twice.
    for first in range(0, count, 2):
        second = min(first + 1, count - 1)
        r, s = np.zeros((2, start.shape[2]), np.float32)
        for q in range(pairs):
            x, y, u, v, w = start[q, 0], start[q, 1], move[q, 0], move[q, 1], seen[q]
            a, b, c, d, e, f = motions[q, first]
            g, h, j, k, m, n = motions[q, second]
            most, limit = caps[q, first], caps[q, second]
            for i in range(len(x)):
                ru, rv = u[i] - a * x[i] - b * y[i] - e, v[i] - c * x[i] - d * y[i] - f
                su, sv = u[i] - g * x[i] - h * y[i] - m, v[i] - j * x[i] - k * y[i] - n
                r[i] += min((ru * ru + rv * rv) * w[i], most)
                s[i] += min((su * su + sv * sv) * w[i], limit)
        total[first], total[second] = r, s
    return total


@compiled(fastmath=_FUSED)
def _activity(start: Floats32, move: Floats32, seen: Floats32, motions: Floats32, caps: Floats32) -> Floats:
    """Mean of r² / (r² + 1 px²) over some of the motions and who is seen, [Q]."""
    activity = np.zeros(len(seen))
    for q in range(len(seen)):
        x, y, u, v, w = start[q, 0], start[q, 1], move[q, 0], move[q, 1], seen[q]
        active = np.zeros(len(x), np.float32)
        fitted = 0
        for h in range(0, motions.shape[1], _ACTIVITY_STEP):
            fitted += caps[q, h] > 0
            a, b, c, d, e, f = motions[q, h]
            for i in range(len(x)):
                ru, rv = u[i] - a * x[i] - b * y[i] - e, v[i] - c * x[i] - d * y[i] - f
                square = min((ru * ru + rv * rv) * w[i], caps[q, h])
                active[i] += square / (square + np.float32(1))
        # Added up one by one: see compiled.
        total = 0.0
        for i in range(len(x)):
            total += active[i]
        activity[q] = total / max(fitted * w.sum(), 1)
    return activity
