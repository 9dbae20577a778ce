"""Compiled: deviations of the distances of pairs of rows, and points that are far from one another."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled


@compiled()
def distance_deviation(y: Floats, w: Floats) -> Floats:
    """Standard deviation of each pair's distance over its common frames: the root of (3.3), equal weights.

    Parameters
    ----------
    y, w
        float64 [n, F, 3] and [n, F] (0: unobserved).

    Returns
    -------
    float64 [n, n], symmetric; NaN where a pair shares fewer than two frames, and on the diagonal.
    """
    n = len(w)
    deviation = np.full((n, n), np.nan)
    for i in range(n):
        for j in range(i + 1, n):
            deviation[i, j] = deviation[j, i] = _deviation(y[i], y[j], w[i], w[j])
    return deviation


@compiled()
def _deviation(a: Floats, b: Floats, wa: Floats, wb: Floats) -> float:
    """Standard deviation of the distance of two rows; NaN where they share fewer than two frames."""
    count, shift, total, squares = 0, 0.0, 0.0, 0.0
    for f in range(len(wa)):
        if wa[f] > 0 and wb[f] > 0:
            x, y, z = a[f, 0] - b[f, 0], a[f, 1] - b[f, 1], a[f, 2] - b[f, 2]
            d = np.sqrt(x * x + y * y + z * z)
            # Sums about the first distance, as E[d^2] - E[d]^2 would cancel.
            shift = d if count == 0 else shift
            total += d - shift
            squares += (d - shift) ** 2
            count += 1
    if count < 2:
        return float(np.nan)
    return float(np.sqrt(max(squares - total * total / count, 0.0) / (count - 1)))


@compiled()
def farthest_points(x: Floats, count: int) -> Ints:
    """Indices of `count` of the points x [n, 3]: the first, then always the farthest from those before."""
    farthest = np.zeros(count, np.intp)
    nearest = np.full(len(x), np.inf)
    for k in range(1, count):
        best, last = 0, farthest[k - 1]
        for i in range(len(x)):
            squared = (x[i, 0] - x[last, 0]) ** 2 + (x[i, 1] - x[last, 1]) ** 2 + (x[i, 2] - x[last, 2]) ** 2
            nearest[i] = min(nearest[i], squared)
            if nearest[i] > nearest[best]:
                best = i
        farthest[k] = best
    return farthest
