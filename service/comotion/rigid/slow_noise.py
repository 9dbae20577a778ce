"""In rows, out what their differences cannot show: slow noise, and how many frames are independent (step 4).

Drift, slip of features, and noise that is correlated over time vanish in differences of neighbours in time.
They show in the distances of features that lie side by side: most such pairs are on one body.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import gammaincinv

from ..arrays import Floats, Ints
from .kernels.correlation import distance_series

# Rows of a source that are looked at, evenly drawn, and nearest rows to compare each with: a median needs no
# more, and beyond three pairs more and more span two bodies.
_ROWS, _NEAREST = 64, 3
# Fewest common frames of a pair, two seconds at the default rate, and fewest pairs of a source.
_LEAST_FRAMES, _LEAST_PAIRS = 8, 8
# The quantile of the pairs that is read: up to this share of the nearest pairs must be on one body.
_QUANTILE = 0.4


@dataclass(frozen=True)
class SlowNoise:
    """Factor from the tolerance of a source to its variance, and the correlation time of that, frames."""

    factor: float = 1.0
    correlation: float = 1.0


def slow_noise(y: Floats, w: Floats, tolerance: Floats, rows: Ints) -> SlowNoise:
    """Slow noise of one source.

    The ratio of a pair's variance of distance (3.3) to its tolerance v_i + v_j is a chi-squared variable
    over its degrees of freedom, the effective samples, times the factor. Its lower quantile over the nearest
    pairs is compared with that of chi-squared.

    Parameters
    ----------
    y, w, tolerance
        float64 [P, F, 3], [P, F] (0: unobserved) and [P], variance of a coordinate.
    rows
        intp [n], current rows of the source.
    """
    if len(rows) <= _NEAREST:
        return SlowNoise()
    some = rows[:: -(-len(rows) // _ROWS)]
    first = np.repeat(some, _NEAREST)
    second = _nearest(y, w, rows, some).ravel()
    found = distance_series(y, w, first, second, _LEAST_FRAMES)
    known = np.isfinite(found[:, 0])
    if known.sum() < _LEAST_PAIRS:
        return SlowNoise()
    ratio = found[known, 0] / (tolerance[first] + tolerance[second])[known]
    near = ratio <= np.quantile(ratio, 2 * _QUANTILE)
    correlation = max(float(np.median(found[known, 1][near])), 1.0)
    samples = max(float(np.median(found[known, 2])) / correlation, 1.0)
    # The quantile of chi-squared; scipy.stats takes a third of a second to import.
    usual = 2 * float(gammaincinv(samples / 2, _QUANTILE)) / samples
    return SlowNoise(max(float(np.quantile(ratio, _QUANTILE)) / usual, 1.0), correlation)


def _nearest(y: Floats, w: Floats, rows: Ints, some: Ints) -> Ints:
    """The rows whose newest positions are nearest to those of each of `some`, intp [n, 3]."""
    last = w.shape[1] - 1 - np.argmax(w[:, ::-1] > 0, axis=1)
    at = np.asarray(y[np.arange(len(y)), last])
    found = cKDTree(at[rows]).query(at[some], _NEAREST + 1)[1]
    return np.asarray(rows[found[:, 1:]], np.intp)
