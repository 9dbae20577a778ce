"""Whether motion goes on from one group into the other.

The image motion of one rigid body varies from place to place as depth does, but trajectories that lie
side by side in it are still similar. Where two bodies meet, they are not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .keyframes import Floats32, KeyFrames

Members = NDArray[np.intp]

_NEAREST = 5
_SAMPLE = 40
_FRAMES = 12
_FLOOR = 1e-3


@dataclass(frozen=True)
class Border:
    """How two groups meet.

    Attributes
    ----------
    drop
        Mean log similarity of the smaller group's members to their nearest in the other one, less
        that to their nearest in the own.
    distance
        px; median distance of these members to their nearest in the other group.
    """

    drop: float
    distance: float


class Continuity:
    """Compares similarity across the border of two groups with that within the smaller one.

    Parameters
    ----------
    frames
        Key frames of N trajectories.
    value
        float32 [N, N]; their similarity.
    """

    def __init__(self, frames: KeyFrames, value: Floats32) -> None:
        step = max(1, len(frames.positions) // _FRAMES)
        self._positions = np.ascontiguousarray(frames.positions[::step].transpose(0, 2, 1))
        self._seen = frames.visible[::step].astype(np.float32)
        self._value = value

    def border(self, first: Members, second: Members) -> Border | None:
        """None where no member of the smaller group is ever seen together with one of the other."""
        small, large = (first, second) if len(first) <= len(second) else (second, first)
        picked = small if len(small) <= _SAMPLE else small[(np.arange(_SAMPLE) * len(small)) // _SAMPLE]
        across, distance = self._to_nearest(picked, large)
        within, _ = self._to_nearest(picked, small)
        known = np.isfinite(distance) & np.isfinite(within)
        if not known.any():
            return None
        return Border(float((across - within)[known].mean()), float(np.median(distance[known])))

    def _to_nearest(
        self, picked: Members, others: Members
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return _nearest(self._positions, self._seen, self._value, picked, others, _NEAREST, _FLOOR)


@compiled()
def _nearest(
    positions: Floats32,
    seen: Floats32,
    value: Floats32,
    picked: Members,
    others: Members,
    nearest: int,
    floor: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Log of the mean similarity to the nearest others, and their mean distance in px; NaN, inf if none."""
    x, y, m = positions[:, 0][:, others], positions[:, 1][:, others], seen[:, others]
    alike = np.full(len(picked), np.nan)
    far = np.full(len(picked), np.inf)
    for p in range(len(picked)):
        i = picked[p]
        distance = _distances(positions[:, 0, i], positions[:, 1, i], seen[:, i], x, y, m)
        distance[others == i] = np.inf
        near = smallest(distance, nearest)
        near = near[np.isfinite(distance[near])]
        if len(near):
            total = 0.0
            for j in near:
                total += value[i, others[j]]
            alike[p] = np.log(total / len(near) + floor)
            far[p] = distance[near].mean()
    return alike, far


@compiled(fastmath={"contract", "reassoc"})
def _distances(px: Floats32, py: Floats32, own: Floats32, x: Floats32, y: Floats32, m: Floats32) -> Floats32:
    """Root mean square distance in the image over common frames, [n]; inf without any."""
    square = np.zeros(x.shape[1], np.float32)
    count = np.zeros(x.shape[1], np.float32)
    for f in range(len(own)):
        if own[f] > 0:
            for j in range(x.shape[1]):
                dx, dy = x[f, j] - px[f], y[f, j] - py[f]
                square[j] += (dx * dx + dy * dy) * m[f, j]
                count[j] += m[f, j]
    for j in range(x.shape[1]):
        square[j] = np.sqrt(square[j] / count[j]) if count[j] > 0 else np.float32(np.inf)
    return square


@compiled()
def smallest(values: Floats32, count: int) -> Members:
    """Indices of the smallest values, in order; the first of equals first."""
    best = np.zeros(min(count, len(values)), np.intp)
    held = 0
    for j in range(len(values)):
        if held == len(best) and values[j] >= values[best[held - 1]]:
            continue
        k = held if held < len(best) else held - 1
        while k > 0 and values[j] < values[best[k - 1]]:
            best[k] = best[k - 1]
            k -= 1
        best[k] = j
        held = min(held + 1, len(best))
    return best
