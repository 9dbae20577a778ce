"""Compiled: interpolates trajectories at common frames, without their gross errors."""

import numpy as np

from ...arrays import Bools, Floats, Ints, Slots, Stamps
from ...compiled import compiled
from ...trajectories.kernels import newest_from, segment_at
from .records import Limits, Observations

BESIDE = 3
"""Observations on either side of one from which the median is taken."""
# Fewest observations of a trajectory; squared distance of a gross error from the median, in variances; and
# the standard deviation in medians of the absolute deviation.
_LEAST_BESIDE, _GROSS, _MAD = 5, 36.0, 1.4826


@compiled()
def resample(
    observations: Observations, stamps: Stamps, limits: Limits, variance: Floats, y: Floats, w: Floats
) -> None:
    """Interpolate linearly at common frames, past gross errors, in place.

    Parameters
    ----------
    stamps
        int64 [F], ns, ascending, the frames.
    variance
        float64 [N], noise of a coordinate; infinite where it is unknown, and no error is gross.
    y, w
        Out: float64 [N, F, 3] and [N, F]; w is the inverse variance relative to that of one observation.
        A point between two observations has less variance than each, an extended one more. Frames without
        an observation are left as they are.
    """
    times, positions, start, stop = observations
    gap, hold, delay = limits
    gross, bend = np.zeros(0, np.bool_), np.zeros((0, positions.shape[1]))
    for i in range(len(start)):
        newest, first = start[i] - 1, start[i]
        if stop[i] - first > len(gross):
            gross, bend = np.zeros(stop[i] - first, np.bool_), np.zeros((stop[i] - first, positions.shape[1]))
        _gross_errors(times[first : stop[i]], positions[first : stop[i]], variance[i], bend, gross)
        for f in range(len(stamps)):
            stamp = stamps[f] - delay[i]
            newest = newest_from(times, newest, stop[i], stamp)
            left, right, a = segment_at(times, first, stop[i], newest, stamp, gap[i], hold[i])
            if left < 0:
                continue
            if gross[left - first] or gross[right - first]:
                # The first and the last observation are never gross errors.
                while gross[left - first]:
                    left -= 1
                while gross[right - first]:
                    right += 1
                if times[right] - times[left] > gap[i]:
                    continue
                a = (stamp - times[left]) / (times[right] - times[left])
            for c in range(positions.shape[1]):
                y[i, f, c] = (1 - a) * positions[left, c] + a * positions[right, c]
            w[i, f] = 1.0 / ((1 - a) ** 2 + a * a)


@compiled()
def _gross_errors(times: Stamps, positions: Floats, variance: float, bend: Floats, gross: Bools) -> None:
    """Which of M observations of a trajectory leave it and come back, to bool [M] (Hampel 1974).

    A feature that moves goes on or stays: only an error is far from the median of the observations around it.
    `bend` [M, dim] is for its use.
    """
    count, dim = positions.shape
    gross[:count] = False
    if count < _LEAST_BESIDE or not np.isfinite(variance):
        return
    bend[0], bend[count - 1] = 0.0, 0.0
    for j in range(1, count - 1):
        a = (times[j] - times[j - 1]) / (times[j + 1] - times[j - 1])
        for c in range(dim):
            bend[j, c] = positions[j, c] - (1 - a) * positions[j - 1, c] - a * positions[j + 1, c]
    for k in range(1, count - 1):
        squared, bend_before, bend_after = 0.0, 0.0, 0.0
        for c in range(dim):
            squared += bend[k, c] * bend[k, c]
            bend_before += bend[k, c] * bend[k - 1, c]
            bend_after += bend[k, c] * bend[k + 1, c]
        # A path that bends, bends on; beside an error it bends the other way.
        if squared > _GROSS * variance and (bend_before < 0 or bend_after < 0):
            around, far, near = positions[max(k - BESIDE, 0) : k + BESIDE + 1], 0.0, 0.0
            for c in range(dim):
                middle = np.median(around[:, c])
                far += (positions[k, c] - middle) ** 2
                near += max((_MAD * np.median(np.abs(around[:, c] - middle))) ** 2, variance)
            gross[k] = far > _GROSS * near


@compiled()
def spread(y: Floats, w: Floats) -> tuple[Ints, Floats]:
    """Frames in which each row is seen, intp [P], and its mean squared distance from its mean, float64 [P].

    `y` float64 [P, F, 3] is 0 where `w` [P, F] is.
    """
    count, squared = np.zeros(len(y), np.intp), np.zeros(len(y))
    for i in range(len(y)):
        m0, m1, m2 = 0.0, 0.0, 0.0
        for f in range(y.shape[1]):
            if w[i, f] > 0:
                m0, m1, m2 = m0 + y[i, f, 0], m1 + y[i, f, 1], m2 + y[i, f, 2]
                count[i] += 1
        n = max(count[i], 1)
        for f in range(y.shape[1]):
            if w[i, f] > 0:
                a, b, c = y[i, f, 0] - m0 / n, y[i, f, 1] - m1 / n, y[i, f, 2] - m2 / n
                squared[i] += (a * a + b * b + c * c) / n
    return count, squared


@compiled()
def mean_square(values: Floats, start: Ints, stop: Ints) -> Floats:
    """Mean square of values[start[i]:stop[i]] for each i, float64 [N]; NaN where one of them is."""
    mean = np.zeros(len(start))
    for i in range(len(start)):
        for m in range(start[i], stop[i]):
            mean[i] += values[m] * values[m]
            if np.isnan(mean[i]):
                break
        mean[i] /= stop[i] - start[i]
    return mean


@compiled()
def stop_at(times: Stamps, slots: Slots, start: Slots, stop: Slots, stamp_ns: int) -> Ints:
    """One past the last observation of each slot up to a time.

    Parameters
    ----------
    times
        int64 [S, M], ns, observations of slot s in [start[s]:stop[s]].
    slots
        intp [N].
    start, stop
        intp [S].

    Returns
    -------
    intp [N], column in `times`.
    """
    stops = np.zeros(len(slots), np.intp)
    for n in range(len(slots)):
        s = slots[n]
        k = stop[s]
        while k > start[s] and times[s, k - 1] > stamp_ns:
            k -= 1
        stops[n] = k
    return stops
