"""Compiled: in rows, out their newest frames, and by how much distances of pairs change within a time."""

import numpy as np

from ...arrays import Floats, Ints
from ...compiled import compiled
from .residuals import observed_span


@compiled()
def newest_frames(w: Floats, rows: Ints) -> Ints:
    """Newest frame in which each of `rows` is observed, intp [n]; the last frame if there is none.

    Parameters
    ----------
    w
        float64 [P, F] (0: unobserved).
    rows
        intp [n].
    """
    found = np.empty(len(rows), np.intp)
    for n in range(len(rows)):
        found[n] = observed_span(w[rows[n]])[1] - 1
    return found


@compiled()
def variograms(y: Floats, w: Floats, first: Ints, second: Ints, lags: Ints, least: int) -> Floats:
    """Half the mean squared difference of the distance of pairs of rows at each lag.

    White noise of the distance adds its variance at every lag; what changes slowly adds little at short
    lags. Frames without a distance are left out.

    Parameters
    ----------
    y, w
        float64 [P, F, 3] and [P, F] (0: unobserved).
    first, second
        intp [n], the rows of each pair.
    lags
        intp [L], in common frames.
    least
        Fewest common frames of a pair, and fewest differences at a lag.

    Returns
    -------
    float64 [n, L]; NaN where there are too few frames.
    """
    found = np.full((len(first), len(lags)), np.nan)
    d = np.empty(w.shape[1])
    for n in range(len(first)):
        i, j, m = first[n], second[n], 0
        for f in range(w.shape[1]):
            if w[i, f] > 0 and w[j, f] > 0:
                a, b, c = y[i, f, 0] - y[j, f, 0], y[i, f, 1] - y[j, f, 1], y[i, f, 2] - y[j, f, 2]
                d[m] = np.sqrt(a * a + b * b + c * c)
                m += 1
        if m < least:
            continue
        for k in range(len(lags)):
            count, total = m - lags[k], 0.0
            if count >= least:
                for f in range(count):
                    total += (d[f + lags[k]] - d[f]) ** 2
                found[n, k] = 0.5 * total / count
    return found
