"""Fits affine displacement fields to displacements over frame pairs, and sums their squared residuals.

A field predicts the displacement (u, v) of a trajectory at (x, y): u = a x + b y + e, v = c x + d y + f.
"""

import numpy as np

from ...arrays import Floats32, Ints
from ...compiled import compiled

# A local motion has six parameters; three members would be fitted exactly, whatever bodies they are on.
_LEAST_MEMBERS = 4


# Halves the time. The products that are fused into sums are all written here, so that it changes no bit from
# one process to another.
@compiled(fastmath={"contract"})
def local_residuals(
    start: Floats32, displacement: Floats32, seen: Floats32, members: Ints, ridge: float, cap: np.float32
) -> tuple[Floats32, Floats32]:
    """Residuals of N trajectories under local motions with members [H, M], fitted in each of Q frame pairs.

    By least squares with a ridge (px² per member) on the diagonal of the centred normal matrix. Of places and
    displacements [Q, 2, N], 0 where not `seen` [Q, N], 1 or 0. Returns sums of squared residuals, px² [H, N],
    each at most `cap`, and whether enough members were seen, 1 or 0, [Q, H].
    """
    total = np.zeros((len(members), start.shape[2]), np.float32)
    used = np.zeros((len(seen), len(members)), np.float32)
    motion = np.zeros(6, np.float32)
    for h in range(len(members)):
        for q in range(len(seen)):
            x, y, u, v, w = start[q, 0], start[q, 1], displacement[q, 0], displacement[q, 1], seen[q]
            n = cx = cy = cu = cv = 0.0
            for i in members[h]:
                n, cx, cy, cu, cv = n + w[i], cx + x[i], cy + y[i], cu + u[i], cv + v[i]
            if n < _LEAST_MEMBERS:
                continue
            used[q, h] = 1
            cx, cy, cu, cv = cx / n, cy / n, cu / n, cv / n
            xx = yy = n * ridge
            xy = xu = yu = xv = yv = 0.0
            for i in members[h]:
                dx, dy, du, dv = (x[i] - cx) * w[i], (y[i] - cy) * w[i], u[i] - cu, v[i] - cv
                xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
                xu, yu, xv, yv = xu + dx * du, yu + dy * du, xv + dx * dv, yv + dy * dv
            det = xx * yy - xy * xy
            motion[0], motion[1] = (xu * yy - yu * xy) / det, (yu * xx - xu * xy) / det
            motion[2], motion[3] = (xv * yy - yv * xy) / det, (yv * xx - xv * xy) / det
            motion[4], motion[5] = cu - motion[0] * cx - motion[1] * cy, cv - motion[2] * cx - motion[3] * cy
            a, b, c, d, e, f = motion
            for i in range(len(x)):
                ru, rv = u[i] - a * x[i] - b * y[i] - e, v[i] - c * x[i] - d * y[i] - f
                total[h, i] += min((ru * ru + rv * rv) * w[i], cap)
    return total, used
