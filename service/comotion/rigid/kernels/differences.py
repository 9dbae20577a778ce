"""Compiled: in observations of each trajectory, out the median squared third difference, which is noise.

The contrast sum_j c_j x_j of four successive observations, with c_j proportional to
1 / prod_{k != j} (t_j - t_k) and sum_j c_j^2 = 1, vanishes on any quadratic motion whatever the
spacing. What is left is noise.
"""

import numpy as np

from ...arrays import Floats, Ints, Slots, Stamps
from ...compiled import compiled
from .records import DifferenceMemory, Observations

# The median is first sought step by step from the last one, up to so many ranks away.
_RANKS = 8


@compiled()
def last_differences(
    observations: Observations, gap: Stamps, slot: Slots, key: Stamps, memory: DifferenceMemory
) -> None:
    """Find what :func:`difference_noise` finds, but compute each difference once.

    Parameters
    ----------
    gap
        As in :func:`difference_noise`.
    slot, key
        intp [N] and int64 [N], entry of the memory for each trajectory, and its stable number.
    memory
        In and out; `median` and `used` are the result, over as many observations as the ring takes.
    """
    times, positions, start, stop = observations
    known, newest, written, squares, median, used, read = memory
    most = squares.shape[1]
    kept = np.empty(most)
    for i in range(len(start)):
        s, last = slot[i], stop[i]
        if known[s] != key[i]:
            known[s], newest[s], written[s], read[s] = key[i], times[start[i]] - 1, 0, -1
        m = last
        while m > start[i] and times[m - 1] > newest[s]:
            m -= 1
        for j in range(max(m, start[i] + 3), last):
            value = _contrast(times, positions, j - 3) if _unbroken(times, j - 3, gap[i]) else np.nan
            squares[s, written[s] % most] = value
            written[s] += 1
        now = max(min(last - start[i], most) - 3, 0)
        if m == last and now == read[s]:
            continue
        newest[s], read[s] = times[last - 1], now
        k = 0
        for j in range(written[s] - now, written[s]):
            if not np.isnan(squares[s, j % most]):
                kept[k] = squares[s, j % most]
                k += 1
        median[s], used[s] = (_median(kept[:k], median[s]) if k > 0 else 0.0), k


@compiled()
def _median(values: Floats, guess: float) -> float:
    """Median of values [n]; fast where it is a few ranks from the guess."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    v = guess
    below, equal = _rank(values, v)
    for _ in range(_RANKS):
        if below > low:
            v = _next_below(values, v)
        elif below + equal <= low:
            v = _next_above(values, v)
        else:
            return v if below + equal > high else 0.5 * (v + _next_above(values, v))
        below, equal = _rank(values, v)
    return float(np.median(values))


@compiled()
def _rank(values: Floats, v: float) -> tuple[int, int]:
    """How many values are below v, and how many equal it."""
    below, equal = 0, 0
    for k in range(len(values)):
        below += values[k] < v
        equal += values[k] == v
    return below, equal


@compiled()
def _next_above(values: Floats, v: float) -> float:
    """The least value above v; infinity where there is none."""
    found = np.inf
    for k in range(len(values)):
        found = min(found, values[k] if values[k] > v else np.inf)
    return found


@compiled()
def _next_below(values: Floats, v: float) -> float:
    """The largest value below v; minus infinity where there is none."""
    found = -np.inf
    for k in range(len(values)):
        found = max(found, values[k] if values[k] < v else -np.inf)
    return found


@compiled()
def difference_noise(observations: Observations, gap: Stamps, most: int) -> tuple[Floats, Ints]:
    """Median squared third difference of the newest `most` observations, and the count of differences.

    No difference is taken across a gap longer than `gap` int64 [N] ns.

    Returns
    -------
    float64 [N] (0 where there is no difference) and intp [N].
    """
    times, positions, start, stop = observations
    median, count = np.zeros(len(start)), np.zeros(len(start), np.intp)
    for i in range(len(start)):
        first = max(start[i], stop[i] - most)
        squares = np.empty(max(stop[i] - first, 0))
        k = 0
        for m in range(first, stop[i] - 3):
            if _unbroken(times, m, gap[i]):
                squares[k] = _contrast(times, positions, m)
                k += 1
        if k > 0:
            median[i], count[i] = np.median(squares[:k]), k
    return median, count


@compiled()
def _unbroken(times: Stamps, m: int, gap: int) -> bool:
    """Whether observations m to m + 3 follow one another without a gap."""
    for j in range(m, m + 3):
        step = times[j + 1] - times[j]
        if step > gap or step <= 0:
            return False
    return True


@compiled()
def _contrast(times: Stamps, positions: Floats, m: int) -> float:
    """Squared length of the normalised third divided difference of observations m to m + 3."""
    c = np.ones(4)
    for j in range(4):
        for k in range(4):
            if k != j:
                # In units of 10 ms, which keep the coefficients near 1; their scale cancels.
                c[j] /= (times[m + j] - times[m + k]) * 1e-7
    squared = 0.0
    for d in range(positions.shape[1]):
        value = 0.0
        for j in range(4):
            value += c[j] * positions[m + j, d]
        squared += value * value
    return float(squared / (c * c).sum())
