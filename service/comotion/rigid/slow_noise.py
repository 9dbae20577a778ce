"""Estimates slow noise, which differences of successive observations do not show (step 4).

Drift, slip of features, and noise that is correlated over time cancel in those differences. They show in the
distances of features that lie side by side: most such pairs are on one body.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from ..arrays import Floats, Ints, last_true, thinned
from .frames import FEWEST

# Most rows of a source that are examined, evenly drawn, and nearest rows to compare each with: a median needs
# no more, and beyond three pairs more and more span two bodies.
_ROWS, _NEAREST = 64, 3
# The quantile of the pairs that is read: up to this share of the nearest pairs must be on one body.
_QUANTILE = 0.4
# s; lags at which the change of distances is read, and fewest lags that tell white noise from slow.
_LAGS, _LEAST_LAGS = 2.0 ** np.arange(7) / 15, 3
# s; correlation times that are tried: octaves up to half of the usual window, and two beyond it.
_TIMES = np.array([2, 4, 8, 16, 32, 64, 256, 1024]) / 15
# Least white noise, in tolerances: interpolation and rounding leave at least this.
_LEAST_WHITE = 0.05


@dataclass(frozen=True)
class SlowNoise:
    """Noise of a source in units of its tolerance: white, and a first-order autoregression.

    `slow` is the variance of the latter; `time` its correlation time in frames. Where that is far longer than
    the window, it is a random walk.
    """

    white: float = 1.0
    slow: float = 0.0
    time: float = 1.0

    @property
    def persistence(self) -> float:
        """Correlation of neighbouring frames."""
        return float(np.exp(-1 / self.time)) if self.slow > 0 else 0.0

    def factor(self, frames: int) -> float:
        """Variance about the mean over a number of frames."""
        return self.white + self.slow * float(1 - np.exp(-frames / 3 / self.time))


def slow_noise(y: Floats, w: Floats, tolerance: Floats, rows: Ints, frame_rate: float) -> SlowNoise:
    """Slow noise of one source, from the variograms of the distances of its nearest pairs.

    The variogram at lag k is that of the white noise plus slow (1 - exp(-k / time)) of the slow one. The
    tolerance stands where it covers all of it.

    Parameters
    ----------
    y, w, tolerance
        float64 [P, F, 3], [P, F] (0: unobserved) and [P], variance of a coordinate.
    rows
        intp [n], current rows of the source.
    frame_rate
        Hz.
    """
    if len(rows) <= _NEAREST:
        return SlowNoise()
    drawn = thinned(rows, _ROWS)
    first = np.repeat(drawn, _NEAREST)
    second = _nearest(y, w, rows, drawn).ravel()
    lags = np.unique(np.maximum(np.round(_LAGS * frame_rate), 1).astype(np.intp))
    measured = variograms(y, w, first, second, lags)
    measurable = np.isfinite(measured).sum(0) >= FEWEST
    if measurable.sum() < _LEAST_LAGS:
        return SlowNoise()
    measured = measured[:, measurable] / (tolerance[first] + tolerance[second])[:, None]
    # np.nanquantile would take longer than all the rest.
    usual = np.array([np.quantile(column[np.isfinite(column)], _QUANTILE) for column in measured.T])
    if usual.min() <= 0:  # pairs at rest without any noise
        return SlowNoise()
    noise = _fitted(lags[measurable], _TIMES * frame_rate, usual)
    return noise if noise.factor(w.shape[1]) > 1 else SlowNoise()


def variograms(y: Floats, w: Floats, first: Ints, second: Ints, lags: Ints) -> Floats:
    """Half the mean squared difference of the distance of pairs of rows at each lag.

    White noise of the distance adds its variance at every lag; what changes slowly adds little at short lags.

    Parameters
    ----------
    y, w
        float64 [P, F, 3] and [P, F] (0: unobserved).
    first, second
        intp [n], the rows of each pair.
    lags
        intp [L], in common frames.

    Returns
    -------
    float64 [n, L]; NaN where there are too few differences.
    """
    both = (w[first] > 0) & (w[second] > 0)
    apart = np.sqrt(((y[first] - y[second]) ** 2).sum(2))
    values = np.full((len(first), len(lags)), np.nan)
    for k, lag in enumerate(lags.tolist()):
        seen = both[:, lag:] & both[:, :-lag]
        change = (apart[:, lag:] - apart[:, :-lag]) * seen
        count = seen.sum(1)
        enough = count >= FEWEST
        values[enough, k] = 0.5 * (change[enough] ** 2).sum(1) / count[enough]
    return values


def _fitted(lags: Ints, times: Floats, usual: Floats) -> SlowNoise:
    """The noise whose variogram is nearest to the usual one, float64 [n], at lags intp [n], of some times."""
    best, least = SlowNoise(), np.inf
    for time in times.tolist():
        variogram = np.column_stack([np.ones(len(lags)), 1 - np.exp(-lags / time)])
        (a, b), error = nnls(variogram / usual[:, None], np.ones(len(lags)))
        if error < least:
            best, least = SlowNoise(max(float(a), _LEAST_WHITE), float(b), time), error
    return best


def _nearest(y: Floats, w: Floats, rows: Ints, drawn: Ints) -> Ints:
    """The rows whose newest positions are nearest to those of each of `drawn`, intp [n, 3]."""
    positions = y[rows, last_true(w[rows] > 0)]
    indices = cKDTree(positions).query(positions[np.searchsorted(rows, drawn)], _NEAREST + 1)[1]
    return np.asarray(rows[indices[:, 1:]], np.intp)
