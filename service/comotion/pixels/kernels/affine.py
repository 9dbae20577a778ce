"""Fits affine displacement fields to displacements over frame pairs, and gives their residuals.

A field predicts the displacement (u, v) of a trajectory at (x, y): u = a x + b y + e, v = c x + d y + f.
"""

import numpy as np

from ...arrays import Floats32, Ints
from ...compiled import compiled

# A local motion has six parameters; three members would be fitted exactly, whatever bodies they are on.
_LEAST_MEMBERS = 4


@compiled()
def fit_local_motions(
    start: Floats32, displacement: Floats32, seen: Floats32, members: Ints, ridge: float
) -> tuple[Floats32, Floats32]:
    """Fields of local motions with members [H, M] in each frame pair, by least squares with a ridge.

    The ridge (px² per member) goes on the diagonal of the centred normal matrix. Returns the fields
    (a, b, c, d, e, f) [Q, H, 6] and whether enough members were seen, 1 or 0, [Q, H].
    """
    motions = np.zeros((len(seen), len(members), 6), np.float32)
    used = np.zeros((len(seen), len(members)), np.float32)
    for q in range(len(seen)):
        for h in range(len(members)):
            n = cx = cy = cu = cv = 0.0
            for i in members[h]:
                n += seen[q, i]
                cx += start[q, 0, i]
                cy += start[q, 1, i]
                cu += displacement[q, 0, i]
                cv += displacement[q, 1, i]
            if n < _LEAST_MEMBERS:
                continue
            used[q, h] = 1
            cx, cy, cu, cv = cx / n, cy / n, cu / n, cv / n
            xx = yy = n * ridge
            xy = xu = yu = xv = yv = 0.0
            for i in members[h]:
                x, y = (start[q, 0, i] - cx) * seen[q, i], (start[q, 1, i] - cy) * seen[q, i]
                u, v = displacement[q, 0, i] - cu, displacement[q, 1, i] - cv
                xx, xy, yy = xx + x * x, xy + x * y, yy + y * y
                xu, yu, xv, yv = xu + x * u, yu + y * u, xv + x * v, yv + y * v
            det = xx * yy - xy * xy
            a, b = (xu * yy - yu * xy) / det, (yu * xx - xu * xy) / det
            c, d = (xv * yy - yv * xy) / det, (yv * xx - xv * xy) / det
            motions[q, h, 0], motions[q, h, 1], motions[q, h, 4] = a, b, cu - a * cx - b * cy
            motions[q, h, 2], motions[q, h, 3], motions[q, h, 5] = c, d, cv - c * cx - d * cy
    return motions, used


# Halves the time. The products that are fused into sums are all written here, so that it changes no bit from
# one process to another.
@compiled(fastmath={"contract"})
def total_residuals(
    start: Floats32, displacement: Floats32, seen: Floats32, motions: Floats32, caps: Floats32
) -> Floats32:
    """Sums of squared residuals of motions [Q, H, 6], each capped (0: the motion does not count), [H, N]."""
    pairs, count, _ = motions.shape
    total = np.zeros((count, start.shape[2]), np.float32)
    for h in range(count):
        for q in range(pairs):
            x, y, u, v, w = start[q, 0], start[q, 1], displacement[q, 0], displacement[q, 1], seen[q]
            a, b, c, d, e, f = motions[q, h]
            for i in range(len(x)):
                ru, rv = u[i] - a * x[i] - b * y[i] - e, v[i] - c * x[i] - d * y[i] - f
                total[h, i] += min((ru * ru + rv * rv) * w[i], caps[q, h])
    return total
