"""Compares groups over wide baselines: whether they are two bodies.

One fundamental matrix per frame pair explains the parts of one rigid body, near and far, to within the noise.
Two bodies, as a rule, do not share one.
"""

from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from .kernels.epipolar import fundamental, sampson
from .key_frames import KeyFrames, evenly_spaced

# Members that represent a group in a frame pair; fewer than the least are not compared.
_POINTS, _LEAST_MEMBERS = 50, 12
# Fewer key frames show no wide baseline. Wide pairs are half of the key frames apart; one more is of the
# first and the last.
_LEAST_FRAMES, _WIDE_PAIRS = 13, 3
# Parameters of a fundamental matrix: so many points are fitted by chance.
_PARAMETERS = 7
# Median of a squared standard normal deviate; px² that are added to a typical squared distance.
_CHI2_MEDIAN_1D, _LEAST_PX2 = 0.455, 1e-6
# nat; log ratio of two groups' joint residual to noise and drift, above which they are two bodies.
_CONTRADICTION = 0.8


class _View(NamedTuple):
    """Points [n, 2] of a group in a pair of frames, and the squared distance expected of them, px²."""

    x: Floats
    y: Floats
    expected: float


class Geometry:
    """Compares the epipolar geometry of groups over wide baselines.

    Parameters
    ----------
    frames
        Key frames of all trajectories.
    drift
        Share of a motion by which features drift or a lens distorts it.
    """

    def __init__(self, frames: KeyFrames, drift: float) -> None:
        self._positions, self._visible = frames.positions.astype(np.float64), frames.visible
        self._drift = drift
        self._views: dict[tuple[int, int, bytes], _View | None] = {}

    def two_bodies(self, first: Ints, second: Ints) -> bool:
        """Whether no fundamental matrix explains two groups together to within noise and drift."""
        excess = []
        for pair in _wide_pairs(len(self._positions)):
            a, b = (self._view(group, pair) for group in (first, second))
            if a is not None and b is not None:
                joint = _squares(np.concatenate([a.x, b.x]), np.concatenate([a.y, b.y]))
                parts = joint[: len(a.x)], joint[len(a.x) :]
                excess.append(max(np.median(parts[0]) / a.expected, np.median(parts[1]) / b.expected, 1e-12))
        return bool(excess) and bool(0.5 * np.log(excess).mean() > _CONTRADICTION)

    def _view(self, group: Ints, pair: tuple[int, int]) -> _View | None:
        """A group in a pair of frames, None if it is too small."""
        key = *pair, group.tobytes()
        if key not in self._views:
            members = group[self._visible[list(pair)][:, group].all(axis=0)]
            chosen = members[evenly_spaced(len(members), _POINTS)]
            x, y = np.ascontiguousarray(self._positions[list(pair)][:, chosen])
            self._views[key] = _View(x, y, self._expected(x, y)) if len(x) >= _LEAST_MEMBERS else None
        return self._views[key]

    def _expected(self, x: Floats, y: Floats) -> float:
        """Typical squared distance of points of one body under a matrix of several, px²."""
        own = float(np.median(_squares(x, y))) * len(x) / (len(x) - _PARAMETERS)
        drift = self._drift * float(np.median(np.linalg.norm(y - x, axis=1)))
        return own + _CHI2_MEDIAN_1D * drift**2 + _LEAST_PX2


def _squares(x: Floats, y: Floats) -> Floats:
    """Squared Sampson distances of points [n, 2] in both frames under their fundamental matrix, px² [n]."""
    return sampson(fundamental(x, y), x, y)


def _wide_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of key frames that are half of `count` apart, and the first and the last; none of too few."""
    if count < _LEAST_FRAMES:
        return []
    half = count // 2
    starts = evenly_spaced(count - half, _WIDE_PAIRS).tolist()
    return [(start, start + half) for start in starts] + [(0, count - 1)]
