"""A test whether two groups share one epipolar geometry.

Under strong perspective an affine view of motion tells near from far parts of one rigid body. One
fundamental matrix per frame pair still explains both. Two bodies share one, as a rule, not.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .keyframes import KeyFrames

Floats = NDArray[np.float64]
Members = NDArray[np.intp]

_LEAST_POINTS = 9
_ROUNDS = 3
_STEP = 4
_PAIRS = 8
_SAMPLE = 50
_FLOOR_PX = 0.05
# A group that moves less than this in a frame pair rests, if the other moves so many times as far.
_RESTING_PX = 1.5
_TIMES_AS_FAR = 10.0
_SLOWEST_PX = 0.2


@dataclass(frozen=True)
class Epipolar:
    """What frame pairs say of two groups.

    Attributes
    ----------
    log_ratio
        Mean of log(joint / own residual). Residuals are medians of the Sampson distance, px; the
        joint one is that of the group that suffers more.
    one_rests
        Whether in some frame pair one group rests in the image while the other moves: then the
        camera rests too, and what moves is another body. An epipolar geometry says nothing here, as
        one that fits a translation fits what rests.
    """

    log_ratio: float
    one_rests: bool


class _Own(NamedTuple):
    """A group in a frame pair: its points [n, 2] in both, own residual and median motion, px."""

    x: Floats
    y: Floats
    residual: float
    motion: float


class EpipolarTest:
    """Compares the epipolar residual of two groups together with that of each alone.

    Parameters
    ----------
    frames
        Key frames of all trajectories.
    """

    def __init__(self, frames: KeyFrames) -> None:
        self._positions = frames.positions.astype(np.float64)
        self._visible = frames.visible
        count = len(self._positions)
        step = min(_STEP, max(count - 1, 1))
        # The newest motion must not be missed: it may be all that there is.
        ends = range(count - 1, step - 1, -max(1, -(-(count - step) // _PAIRS)))
        self._pairs = [(t - step, t) for t in ends]
        self._alone: dict[bytes, list[_Own]] = {}

    def compare(self, first: Members, second: Members) -> Epipolar | None:
        """Compare two groups; None where too few points are seen."""
        pairs = [
            (a, b)
            for a, b in zip(self._own(first), self._own(second), strict=True)
            if min(len(a.x), len(b.x)) >= _LEAST_POINTS
        ]
        if not pairs:
            return None
        log_ratio = float(np.mean([_log_ratio(a, b) for a, b in pairs]))
        return Epipolar(log_ratio, any(_one_rests(a.motion, b.motion) for a, b in pairs))

    def _own(self, group: Members) -> list[_Own]:
        key = group.tobytes()
        if key not in self._alone:
            self._alone[key] = [self._fit(group, *pair) for pair in self._pairs]
        return self._alone[key]

    def _fit(self, group: Members, first: int, second: int) -> _Own:
        seen = group[self._visible[first, group] & self._visible[second, group]]
        if len(seen) > _SAMPLE:
            seen = seen[(np.arange(_SAMPLE) * len(seen)) // _SAMPLE]
        x, y = self._positions[first, seen], self._positions[second, seen]
        if len(seen) < _LEAST_POINTS:
            return _Own(x, y, 0.0, 0.0)
        return _Own(x, y, *_alone(x, y))


def _log_ratio(a: _Own, b: _Own) -> float:
    joint = _joint(a.x, a.y, b.x, b.y)
    alone = (a.residual + b.residual) / 2
    return math.log((math.sqrt(joint) + _FLOOR_PX) / (math.sqrt(alone) + _FLOOR_PX))


def _one_rests(first: float, second: float) -> bool:
    slow, fast = min(first, second), max(first, second)
    return slow < _RESTING_PX and fast > _TIMES_AS_FAR * max(slow, _SLOWEST_PX)


@compiled()
def _normalisation(x: Floats) -> tuple[float, float, float]:
    """Scale and shift that bring points [n, 2] to the origin at mean distance √2 (Hartley 1997)."""
    cx, cy = x[:, 0].mean(), x[:, 1].mean()
    reach = np.sqrt((x[:, 0] - cx) ** 2 + (x[:, 1] - cy) ** 2).mean()
    scale = np.sqrt(2.0) / max(reach, 1e-9)
    return scale, -scale * cx, -scale * cy


@compiled()
def _rows(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Equations [n, 9] of the eight-point method with the normalising [3, 3] of both sides."""
    sx, ax, bx = _normalisation(x)
    sy, ay, by = _normalisation(y)
    u, v = sx * x[:, 0] + ax, sx * x[:, 1] + bx
    p, q = sy * y[:, 0] + ay, sy * y[:, 1] + by
    rows = np.ones((len(x), 9))
    for k, column in enumerate((p * u, p * v, p, q * u, q * v, q, u, v)):
        rows[:, k] = column
    left = np.array([[sx, 0.0, ax], [0.0, sx, bx], [0.0, 0.0, 1.0]])
    right = np.array([[sy, 0.0, ay], [0.0, sy, by], [0.0, 0.0, 1.0]])
    return rows, left, right


@compiled()
def _sampson(f: Floats, x: Floats, y: Floats) -> Floats:
    """Squared Sampson distances [n], px²."""
    ax = f[0, 0] * x[:, 0] + f[0, 1] * x[:, 1] + f[0, 2]
    ay = f[1, 0] * x[:, 0] + f[1, 1] * x[:, 1] + f[1, 2]
    az = f[2, 0] * x[:, 0] + f[2, 1] * x[:, 1] + f[2, 2]
    bx = f[0, 0] * y[:, 0] + f[1, 0] * y[:, 1] + f[2, 0]
    by = f[0, 1] * y[:, 0] + f[1, 1] * y[:, 1] + f[2, 1]
    error = y[:, 0] * ax + y[:, 1] * ay + az
    square: Floats = error**2 / np.maximum(ax**2 + ay**2 + bx**2 + by**2, 1e-12)
    return square


@compiled()
def _robust_residuals(x: Floats, y: Floats, prior: Floats) -> Floats:
    """Squared Sampson distances [n] under a reweighted eight-point fit; `prior` [n] weighs points."""
    rows, left, right = _rows(x, y)
    weight = prior.copy()
    square = np.zeros(len(x))
    for _ in range(_ROUNDS):
        scaled = rows * weight.reshape(-1, 1)
        vector = np.linalg.eigh(scaled.T @ scaled)[1][:, 0]
        u, s, vt = np.linalg.svd(np.ascontiguousarray(vector).reshape(3, 3))
        s[2] = 0
        square = _sampson(right.T @ ((u * s) @ vt) @ left, x, y)
        weight = prior / np.sqrt(1 + square / (4 * max(np.median(square), 0.01)))
    return square


@compiled()
def _alone(x: Floats, y: Floats) -> tuple[float, float]:
    """Median squared residual of points that are fitted alone, px², and their median motion, px."""
    move = y - x
    moved = np.sqrt(move[:, 0] ** 2 + move[:, 1] ** 2)
    return np.median(_robust_residuals(x, y, np.ones(len(x)))), np.median(moved)


@compiled()
def _joint(xa: Floats, ya: Floats, xb: Floats, yb: Floats) -> float:
    """Median squared residual of the group that suffers more when both are fitted together, px²."""
    count = len(xa)
    prior = np.empty(count + len(xb))
    # A large group must not outvote a small one.
    prior[:count] = count**-0.5
    prior[count:] = len(xb) ** -0.5
    square = _robust_residuals(np.concatenate((xa, xb)), np.concatenate((ya, yb)), prior)
    joint: float = max(np.median(square[:count]), np.median(square[count:]))
    return joint
