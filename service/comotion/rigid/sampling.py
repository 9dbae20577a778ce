"""Compiled: trajectories at common frames, and the noise of their own samples."""

import numpy as np

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from ..compiled import compiled

# So far from the last median, in ranks, the next is sought step by step.
_RANKS = 8


@compiled()
def resample(
    times: Stamps,
    positions: Floats,
    start: Ints,
    stop: Ints,
    stamps: Stamps,
    gap: Stamps,
    hold: Stamps,
    delay: Stamps,
    y: Floats,
    w: Floats,
) -> None:
    """Fill y [N, F, 3] and w [N, F] by linear interpolation, never across a gap longer than `gap` [N].

    w is the inverse variance relative to one observation: a point between two is quieter, one up to
    `hold` [N] past the newest louder; 0 where unobserved. `delay` [N] is added to the times.
    """
    for i in range(len(start)):
        m, last = start[i], stop[i] - 1
        newest, first_ns = times[last], times[m]
        until = newest + hold[i]
        for f in range(len(stamps)):
            t = stamps[f] - delay[i]
            if t < first_ns or t > until:
                continue
            while m < last and times[m + 1] <= t:
                m += 1
            # The newest segment also serves to extend the trajectory.
            left = m if m < last else max(last - 1, start[i])
            right = min(left + 1, last)
            span = times[right] - times[left]
            a = 1.0
            if not (t >= newest and (t == newest or span == 0 or span > gap[i])):
                if span > gap[i]:
                    continue
                a = (t - times[left]) / span
            for c in range(positions.shape[1]):
                y[i, f, c] = (1 - a) * positions[left, c] + a * positions[right, c]
            w[i, f] = 1.0 / ((1 - a) ** 2 + a * a)


@compiled()
def move(y: Floats, w: Floats, turn: Floats, shift: Floats, moved: Bools) -> None:
    """Y = turn y + shift where observed, in place, for rows of `moved` [N]."""
    for i in range(len(w)):
        if not moved[i]:
            continue
        for f in range(w.shape[1]):
            if w[i, f] > 0:
                a, b, c = y[i, f, 0], y[i, f, 1], y[i, f, 2]
                for d in range(3):
                    y[i, f, d] = turn[i, d, 0] * a + turn[i, d, 1] * b + turn[i, d, 2] * c + shift[i, d]


@compiled()
def scatter(y: Floats, w: Floats, count: Ints, squared: Floats) -> None:
    """How many frames of each row are observed, and the mean squared distance from their mean; [N] each."""
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
    """Mean square of values[start:stop], NaN where one is, [N]."""
    found = np.zeros(len(start))
    for i in range(len(start)):
        for m in range(start[i], stop[i]):
            found[i] += values[m] * values[m]
            if np.isnan(found[i]):
                break
        found[i] /= stop[i] - start[i]
    return found


@compiled()
def all_known(values: Floats, start: Ints, stop: Ints) -> Bools:
    """Whether all of values[start:stop], [M, 4], are finite, [N]."""
    found = np.ones(len(start), np.bool_)
    for i in range(len(start)):
        for m in range(start[i], stop[i]):
            if not np.isfinite(values[m]).all():
                found[i] = False
                break
    return found


@compiled()
def last_differences(
    times: Stamps,
    positions: Floats,
    start: Ints,
    stop: Ints,
    gap: Stamps,
    slot: Slots,
    key: Stamps,
    known: Stamps,
    newest: Stamps,
    written: Ints,
    squares: Floats,
    median: Floats,
    count: Ints,
    asked: Ints,
) -> None:
    """What :func:`difference_noise` finds, from squares that are kept for every slot and extended.

    Parameters
    ----------
    known, newest, written, squares, median, count, asked
        By slot: whose squares they are; the time they go up to; how many there have ever been; the
        last of them, a ring; and the outcome, over so many of them. In and out.
    """
    most = squares.shape[1]
    kept = np.empty(most)
    for i in range(len(start)):
        s, last = slot[i], stop[i]
        if known[s] != key[i]:
            known[s], newest[s], written[s], asked[s] = key[i], times[start[i]] - 1, 0, -1
        m = last
        while m > start[i] and times[m - 1] > newest[s]:
            m -= 1
        for j in range(max(m, start[i] + 3), last):
            value = _contrast(times, positions, j - 3) if _unbroken(times, j - 3, gap[i]) else np.nan
            squares[s, written[s] % most] = value
            written[s] += 1
        now = max(min(last - start[i], most) - 3, 0)
        if m == last and now == asked[s]:
            continue
        newest[s], asked[s] = times[last - 1], now
        k = 0
        for j in range(written[s] - now, written[s]):
            if not np.isnan(squares[s, j % most]):
                kept[k] = squares[s, j % most]
                k += 1
        median[s], count[s] = (_median(kept[:k], median[s]) if k > 0 else 0.0), k


@compiled()
def _median(values: Floats, guess: float) -> float:
    """Median, sought from a guess a few ranks away: that of before."""
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
    below, equal = 0, 0
    for k in range(len(values)):
        below += values[k] < v
        equal += values[k] == v
    return below, equal


@compiled(fastmath={"nnan", "nsz", "reassoc"})
def _next_above(values: Floats, v: float) -> float:
    found = np.inf
    for k in range(len(values)):
        found = min(found, values[k] if values[k] > v else np.inf)
    return found


@compiled(fastmath={"nnan", "nsz", "reassoc"})
def _next_below(values: Floats, v: float) -> float:
    found = -np.inf
    for k in range(len(values)):
        found = max(found, values[k] if values[k] < v else -np.inf)
    return found


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
def deviation_from(y: Floats, w: Floats, row: int, others: Ints) -> Floats:
    """Those of one row's distance from each of others [n], float64 [n]."""
    found = np.empty(len(others))
    for k in range(len(others)):
        found[k] = _deviation(y[row], y[others[k]], w[row], w[others[k]])
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
