"""(3.2) to (3.5) of the thesis, word for word: slow, without sums that are carried along.

A trajectory is a list of observations. Everything is computed anew from the lists, pair by pair and
sample by sample, so that it can be checked against the paper by reading.
"""

import math
from dataclasses import dataclass, field

Point = tuple[float, ...]


@dataclass
class Trajectory:
    """All that was ever observed, by time; of it, only what is no older than `oldest` is in the window."""

    history: dict[int, Point] = field(default_factory=dict)
    oldest: int = -(2**63)

    def times(self) -> list[int]:
        return sorted(t for t in self.history if t >= self.oldest)

    def speed(self, t: int) -> float:
        """Backward difference; the first observation takes the second's."""
        ever = sorted(self.history)
        m = max(ever.index(t), 1)
        if len(ever) == 1:
            return 0.0
        step = math.dist(self.history[ever[m]], self.history[ever[m - 1]])
        return step / ((ever[m] - ever[m - 1]) * 1e-9)


def interpolate(j: Trajectory, t: int, gap: int) -> tuple[Point, float] | None:
    """State of j at t and the speed of the segment that holds t; None where there is a gap."""
    times = j.times()
    for k in range(len(times) - 1):
        if times[k] < t < times[k + 1]:
            if times[k + 1] - times[k] > gap:
                return None
            a = (t - times[k]) / (times[k + 1] - times[k])
            left, right = j.history[times[k]], j.history[times[k + 1]]
            state = tuple(a * after + (1 - a) * before for before, after in zip(left, right, strict=True))
            return state, j.speed(times[k + 1])
    raise AssertionError("outside of the trajectory")


def samples(i: Trajectory, j: Trajectory, gap: int) -> list[tuple[float, float]]:
    """(distance, greater squared speed) at each instant of the set (3.5)."""
    times_i, times_j = i.times(), j.times()
    if not times_i or not times_j:
        return []
    begin, end = max(times_i[0], times_j[0]), min(times_i[-1], times_j[-1])
    found = []
    for t in sorted({*times_i, *times_j}):
        if not begin <= t <= end:
            continue
        state_i = (i.history[t], i.speed(t)) if t in times_i else interpolate(i, t, gap)
        state_j = (j.history[t], j.speed(t)) if t in times_j else interpolate(j, t, gap)
        if state_i is None or state_j is None:
            continue
        found.append((math.dist(state_i[0], state_j[0]), max(state_i[1] ** 2, state_j[1] ** 2)))
    return found


def weight(v_squared: float, v_move: float | None) -> float:
    """(3.2)"""
    if v_move is None:
        return 1.0
    rate = -math.log(1 - 0.9) / v_move**2
    epsilon = 1e-3 * v_move**2
    return 1 - math.exp(-rate * (v_squared + epsilon))


def variance(i: Trajectory, j: Trajectory, gap: int, v_move: float | None) -> float | None:
    """(3.3), as the mean squared deviation from the mean, which is the same; None: not comparable."""
    pair = samples(i, j, gap)
    if len(pair) < 2:
        return None
    weights = [weight(v_squared, v_move) for _, v_squared in pair]
    eta = 1 / math.fsum(weights)
    mean = eta * math.fsum(w * d for w, (d, _) in zip(weights, pair, strict=True))
    return eta * math.fsum(w * (d - mean) ** 2 for w, (d, _) in zip(weights, pair, strict=True))


def affinity(i: Trajectory, j: Trajectory, gap: int, v_move: float | None, sigma_switch: float) -> float:
    """(3.4)"""
    spread = variance(i, j, gap, v_move)
    return 0.5 if spread is None else math.exp(math.log(0.5) / sigma_switch**2 * spread)
