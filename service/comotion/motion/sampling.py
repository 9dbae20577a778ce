"""Compiled: trajectories at common frames, and the noise of their own samples."""

import numpy as np

from ..compiled import compiled
from ..window import Floats, Stamps
from .tracks import Ints


@compiled()
def resample(
    times: Stamps,
    positions: Floats,
    start: Ints,
    stop: Ints,
    stamps: Stamps,
    gap: Stamps,
    hold: Stamps,
    y: Floats,
    w: Floats,
) -> None:
    """Fill y [N, F, 3] and w [N, F] by linear interpolation, never across a gap longer than `gap` [N].

    w is the inverse variance relative to one observation: a point between two is quieter, one up to
    `hold` [N] past the newest louder; 0 where unobserved.
    """
    for i in range(len(start)):
        m, last = start[i], stop[i] - 1
        for f in range(len(stamps)):
            t = stamps[f]
            if t < times[m] or t > times[last] + hold[i]:
                continue
            while m < last and times[m + 1] <= t:
                m += 1
            # The newest segment also serves to extend the trajectory.
            left = m if m < last else max(last - 1, start[i])
            w[i, f] = _state_at(times, positions, left, last, t, gap[i], y[i, f])


@compiled()
def _state_at(
    times: Stamps, positions: Floats, left: int, last: int, t: int, gap: int, state: Floats
) -> float:
    """State on the line through observations left and left + 1, and its relative inverse variance."""
    right = min(left + 1, last)
    span = times[right] - times[left]
    if t >= times[last] and (t == times[last] or span == 0 or span > gap):
        a = 1.0
    elif span > gap:
        return 0.0
    else:
        a = (t - times[left]) / span
    for c in range(positions.shape[1]):
        state[c] = (1 - a) * positions[left, c] + a * positions[right, c]
    return float(1.0 / ((1 - a) ** 2 + a * a))


@compiled()
def difference_noise(
    times: Stamps, positions: Floats, start: Ints, stop: Ints, gap: Stamps, most: int
) -> tuple[Floats, Ints]:
    """Median squared third divided difference of the newest `most` samples, and their count, [N] each.

    The contrast sum_j c_j x_j, c_j = 1 / prod_{k != j} (t_j - t_k) and sum_j c_j^2 = 1, vanishes on any
    quadratic motion whatever the spacing, so what is left is noise.
    """
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
    for j in range(m, m + 3):
        step = times[j + 1] - times[j]
        if step > gap or step <= 0:
            return False
    return True


@compiled()
def _contrast(times: Stamps, positions: Floats, m: int) -> float:
    """Squared length of the normalised third divided difference of samples m to m + 3."""
    c = np.ones(4)
    for j in range(4):
        for k in range(4):
            if k != j:
                c[j] /= (times[m + j] - times[m + k]) * 1e-7
    squared = 0.0
    for d in range(positions.shape[1]):
        value = 0.0
        for j in range(4):
            value += c[j] * positions[m + j, d]
        squared += value * value
    return float(squared / (c * c).sum())


@compiled()
def distance_deviation(y: Floats, w: Floats) -> Floats:
    """Standard deviation of the distance of each pair over common frames (3.3), [n, n].

    NaN where a pair shares fewer than two frames.
    """
    n = len(w)
    found = np.full((n, n), np.nan)
    for i in range(n):
        for j in range(i + 1, n):
            found[i, j] = found[j, i] = _deviation(y[i], y[j], w[i], w[j])
    return found


@compiled()
def _deviation(a: Floats, b: Floats, wa: Floats, wb: Floats) -> float:
    count, shift, total, squares = 0, 0.0, 0.0, 0.0
    for f in range(len(wa)):
        if wa[f] > 0 and wb[f] > 0:
            x, y, z = a[f, 0] - b[f, 0], a[f, 1] - b[f, 1], a[f, 2] - b[f, 2]
            d = np.sqrt(x * x + y * y + z * z)
            # About the first: E[d^2] - E[d]^2 would cancel.
            shift = d if count == 0 else shift
            total += d - shift
            squares += (d - shift) ** 2
            count += 1
    if count < 2:
        return float(np.nan)
    return float(np.sqrt(max(squares - total * total / count, 0.0) / (count - 1)))
