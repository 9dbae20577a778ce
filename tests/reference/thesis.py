"""Affinity of two trajectories: equations (3.3) to (3.5) of the thesis, as they stand.

The thesis is "Inferring Object Hypotheses Based on Feature Motion from Different Sources". Nothing is kept
from update to update: :mod:`comotion.thesis.pair_sums` computes the same for all pairs, step by step.
Integrals over time become sums over the samples of (3.5).
"""

import math
from typing import NamedTuple

import numpy as np

from comotion.arrays import Bools, Floats, Stamps
from comotion.thesis.pair_sums import AFFINITY_AT_SWITCH


class Observations(NamedTuple):
    """One trajectory: times int64 [M] ns, ascending; positions float64 [M, dim]; speed float64 [M] per s."""

    times: Stamps
    positions: Floats
    speed: Floats


def backward_speed(times: Stamps, positions: Floats) -> Floats:
    """Speed at each observation, float64 [M]: the backward difference v_i,m of the thesis.

    The first observation takes the second's; a single one has speed 0.

    Parameters
    ----------
    times
        int64 [M] ns, ascending.
    positions
        float64 [M, dim].
    """
    if len(times) < 2:
        return np.zeros(len(times))
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1) / (np.diff(times) * 1e-9)
    return np.concatenate([steps[:1], steps])


def variance(distance: Floats, weights: Floats) -> float:
    """(3.3): σ² = η Σ w d² − (η Σ w d)² with η = 1 / Σ w.

    It is the variance; where the thesis writes σ_ij for it, after (3.5), the square is missing.

    Parameters
    ----------
    distance, weights
        float64 [M], of the samples of a pair.
    """
    # As printed, two large numbers cancel; about any shift of d the variance is the same.
    shifted = distance - distance[0]
    eta = 1 / weights.sum()
    return float(max(eta * (weights * shifted**2).sum() - (eta * (weights * shifted).sum()) ** 2, 0.0))


def affinity(variances: Floats, sigma_switch: float) -> Floats:
    """(3.4): a = exp(−γσ²) with γ = −ln 0.5 / sigma_switch².

    Parameters
    ----------
    variances
        float64 [...], (3.3).
    sigma_switch
        Standard deviation at which the affinity is 0.5, in the unit of the distances.
    """
    return np.asarray(np.exp(math.log(AFFINITY_AT_SWITCH) / sigma_switch**2 * variances))


def distance_samples(i: Observations, j: Observations, max_gap: int) -> tuple[Floats, Floats]:
    """(3.5): distances at every observation of either trajectory inside their common interval.

    The other trajectory is interpolated linearly. An instant at which both are observed is one sample.
    Erratum: the denominator of a, printed as t_i,k+1 − t_j,k, is t_j,k+1 − t_j,k.

    Parameters
    ----------
    i, j
        Both with an observation or more.
    max_gap
        Longest time between two observations to interpolate across, ns.

    Returns
    -------
    distance, speed
        float64 [M] each: d_ij and the larger speed of the two, at ascending times. Between observations the
        speed is that of the segment.
    """
    begin, end = max(i.times[0], j.times[0]), min(i.times[-1], j.times[-1])
    times = np.union1d(i.times, j.times)
    times = times[(times >= begin) & (times <= end)]
    x_i, v_i, held_i = _interpolate(i, times, max_gap)
    x_j, v_j, held_j = _interpolate(j, times, max_gap)
    held = held_i & held_j
    return np.linalg.norm(x_i - x_j, axis=1)[held], np.maximum(v_i, v_j)[held]


def _interpolate(j: Observations, times: Stamps, max_gap: int) -> tuple[Floats, Floats, Bools]:
    """States, speeds, and whether there is a state, at times [T] inside of the trajectory."""
    right = np.searchsorted(j.times, times)
    left = np.where(j.times[right] == times, right, right - 1)
    span = j.times[right] - j.times[left]
    a = ((times - j.times[left]) / np.maximum(span, 1))[:, None]
    return a * j.positions[right] + (1 - a) * j.positions[left], j.speed[right], span <= max_gap
