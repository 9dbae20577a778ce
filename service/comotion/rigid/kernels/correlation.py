"""Compiled: in pairs of rows, out the variance of their distance and for how many frames it is correlated."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled

# Lags at which the autocovariance is computed, evenly spread: enough for the sum of its squares.
_LAGS = 40


@compiled()
def distance_series(y: Floats, w: Floats, first: Ints, second: Ints, least: int) -> Floats:
    """Variance, correlation time and length of the distance of pairs of rows over their common frames.

    The correlation time is 1 + 2 sum_k rho_k^2 frames, from the autocorrelation rho_k at lag k: the sample
    variance of so many times fewer independent samples scatters as much. 1 / m, by which the square of an
    estimated rho_k is too large on average, is taken off.

    Parameters
    ----------
    y, w
        float64 [P, F, 3] and [P, F] (0: unobserved).
    first, second
        intp [n], the rows of each pair.
    least
        Fewest common frames.

    Returns
    -------
    float64 [n, 3]: variance, correlation time in frames, and number m of common frames; NaN for pairs with
    fewer than `least` of them.
    """
    found = np.full((len(first), 3), np.nan)
    d = np.empty(w.shape[1])
    for n in range(len(first)):
        i, j, m, mean = first[n], second[n], 0, 0.0
        for f in range(w.shape[1]):
            if w[i, f] > 0 and w[j, f] > 0:
                a, b, c = y[i, f, 0] - y[j, f, 0], y[i, f, 1] - y[j, f, 1], y[i, f, 2] - y[j, f, 2]
                d[m] = np.sqrt(a * a + b * b + c * c)
                mean += d[m]
                m += 1
        if m < least:
            continue
        mean /= m
        variance = 0.0
        for k in range(m):
            d[k] -= mean
            variance += d[k] * d[k]
        variance = max(variance / (m - 1), 1e-300)
        found[n, 0], found[n, 1], found[n, 2] = variance, _correlation_time(d[:m], variance), m
    return found


@compiled()
def _correlation_time(d: Floats, variance: float) -> float:
    """1 + 2 sum_k (rho_k^2 - 1 / m) of a centred series [m], at least 1."""
    m, excess = len(d), 0.0
    step = max(1, m // _LAGS)
    for lag in range(1, m // 2, step):
        covariance = 0.0
        for k in range(m - lag):
            covariance += d[k] * d[k + lag]
        rho = covariance / ((m - 1) * variance)
        excess += step * (rho * rho - 1.0 / m)
    return 1.0 + 2.0 * max(excess, 0.0)
