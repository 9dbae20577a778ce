"""Compiled: in observations of each trajectory, out its positions at common frames."""

import numpy as np

from ...arrays import Floats, Ints, Slots, Stamps
from ...compiled import compiled
from ...trajectories.kernels import newest_from, segment_at
from .records import Limits, Observations


@compiled()
def resample(observations: Observations, stamps: Stamps, limits: Limits, y: Floats, w: Floats) -> None:
    """Interpolate linearly at common frames, in place.

    Parameters
    ----------
    stamps
        int64 [F], ns, ascending, the frames.
    y, w
        Out: float64 [N, F, 3] and [N, F]; w is the inverse variance relative to that of one observation.
        A point between two observations has less variance than each, an extended one more. Frames without
        an observation are left as they are.
    """
    times, positions, start, stop = observations
    gap, hold, delay = limits
    for i in range(len(start)):
        newest = start[i] - 1
        for f in range(len(stamps)):
            stamp = stamps[f] - delay[i]
            newest = newest_from(times, newest, stop[i], stamp)
            left, right, a = segment_at(times, start[i], stop[i], newest, stamp, gap[i], hold[i])
            if left < 0:
                continue
            for c in range(positions.shape[1]):
                y[i, f, c] = (1 - a) * positions[left, c] + a * positions[right, c]
            w[i, f] = 1.0 / ((1 - a) ** 2 + a * a)


@compiled()
def spread(y: Floats, w: Floats, count: Ints, squared: Floats) -> None:
    """Count the observed frames of each row, and take their mean squared distance from their mean.

    Parameters
    ----------
    y, w
        float64 [P, F, 3] and [P, F] (0: unobserved).
    count, squared
        Out: intp [P] and float64 [P].
    """
    for i in range(len(w)):
        n, a, b, c = 0, 0.0, 0.0, 0.0
        for f in range(w.shape[1]):
            if w[i, f] > 0:
                n += 1
                a += y[i, f, 0]
                b += y[i, f, 1]
                c += y[i, f, 2]
        count[i], squared[i] = n, 0.0
        if n == 0:
            continue
        a, b, c = a / n, b / n, c / n
        total = 0.0
        for f in range(w.shape[1]):
            if w[i, f] > 0:
                total += (y[i, f, 0] - a) ** 2 + (y[i, f, 1] - b) ** 2 + (y[i, f, 2] - c) ** 2
        squared[i] = total / n


@compiled()
def mean_square(values: Floats, start: Ints, stop: Ints) -> Floats:
    """Mean square of values[start[i]:stop[i]] for each i, float64 [N]; NaN where one of them is."""
    found = np.zeros(len(start))
    for i in range(len(start)):
        for m in range(start[i], stop[i]):
            found[i] += values[m] * values[m]
            if np.isnan(found[i]):
                break
        found[i] /= stop[i] - start[i]
    return found


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
    found = np.zeros(len(slots), np.intp)
    for n in range(len(slots)):
        s = slots[n]
        k = stop[s]
        while k > start[s] and times[s, k - 1] > stamp_ns:
            k -= 1
        found[n] = k
    return found
