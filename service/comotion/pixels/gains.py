"""Recent motion in; how well rest, and the motion of a group, explain that of each trajectory, out.

A gain is evidence in nat per update: 1 where the motion is explained, 0 at three standard deviations, and
negative beyond, down to a limit.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats
from .recent import SCALES_NS, Recent

WORST = -3.0
"""nat; least gain: what contradicts its hypothesis leaves it within two updates."""

# Squared standard deviations at which the gain is 0.
_GATE = 9.0
# px; drift of a resting feature over each time scale, beside its noise. The first ones hold for bodies too.
_DRIFT_PX = (0.3, 0.45, 0.8, 1.2)
# Time scales over which bodies are compared: over longer ones they turn, and hands change their shape.
_BODY_SCALES = 2
# Share of its motion by which a member of a body may deviate: hands are not rigid.
_DEVIATION = 0.15
# Fewer members explain themselves.
_LEAST_MEMBERS = 4
# From so many members on the motion of a group is quadratic in place, as that of a ball, or of a page that
# is turned.
_LEAST_QUADRATIC = 12
# Regularisation per member: px² of the linear part, and of the quadratic one at unit extent.
_RIDGE_PX2, _QUADRATIC_RIDGE = 25.0, 0.1
_ROUNDS = 4
# px²; smallest variance of members about the motion of their group.
_LEAST_VARIANCE = 0.05
# px; a group that has moved less over any time scale rests.
_AT_REST_PX = 0.5


class Explained(NamedTuple):
    """Gains float64 [n] under the motion of a group, and its speed: px over the longest time scale seen."""

    gain: Floats
    motion: float


def rest_gain(recent: Recent, scales: int = len(SCALES_NS)) -> Floats:
    """Gain under rest, float64 [n]: the least over the first `scales` time scales, 0 if seen in none."""
    gain = np.where(recent.seen[:scales].any(axis=0), 1.0, 0.0)
    for k in range(scales):
        square = (recent.displacement[k] ** 2).sum(axis=1)
        variance = 2 * (recent.variance + _DRIFT_PX[k] ** 2)
        gain = np.where(recent.seen[k], np.minimum(gain, _gain(square, variance)), gain)
    return gain


def group_gain(recent: Recent, members: Bools) -> Explained | None:
    """Gain of all trajectories under the motion of a group, None where too few of it were seen.

    A group that rests is explained as rest is: nothing tells it from the background then.

    Parameters
    ----------
    recent
        Of n trajectories.
    members
        bool [n].
    """
    gain, motion = np.ones(len(members)), 0.0
    known = np.zeros(len(members), np.bool_)
    for k in range(_BODY_SCALES):
        mine, step = members & recent.seen[k], recent.displacement[k]
        count = int(mine.sum())
        if count < _LEAST_MEMBERS:
            continue
        start = recent.position - step
        expected = _fit(start[mine], step[mine])(start)
        square = ((step - expected) ** 2).sum(axis=1)
        # Members have drawn the motion towards themselves.
        square[mine] *= count / (count - 3)
        slack = (_DEVIATION**2) * (expected**2).sum(axis=1)
        variance = 2 * (recent.variance + _DRIFT_PX[k] ** 2) + slack
        gain = np.where(recent.seen[k], np.minimum(gain, _gain(square, variance)), gain)
        known |= recent.seen[k]
        motion = max(motion, float(np.sqrt(np.median((step[mine] ** 2).sum(axis=1)))))
    if not known.any():
        return None
    if motion < _AT_REST_PX:
        return Explained(rest_gain(recent, _BODY_SCALES), motion)
    return Explained(np.where(known, gain, 0.0), motion)


def _gain(square: Floats, variance: Floats) -> Floats:
    return np.clip(1 - square / (_GATE * variance), WORST, 1)


def _fit(start: Floats, step: Floats) -> Callable[[Floats], Floats]:
    """Displacement as a function of place, px [n, 2] both; fitted robustly."""
    centre = start.mean(axis=0)
    extent = max(float(np.sqrt(((start - centre) ** 2).sum(axis=1).mean() / 2)), 1.0)
    quadratic = len(start) >= _LEAST_QUADRATIC

    def basis(place: Floats) -> Floats:
        x, y = ((place - centre) / extent).T
        terms = [np.ones(len(place)), x, y]
        return np.stack([*terms, x * x, x * y, y * y] if quadratic else terms, axis=1)

    ridge = np.diag([0.0] + 2 * [_RIDGE_PX2 / extent**2] + quadratic * 3 * [_QUADRATIC_RIDGE])
    rows, coefficients = basis(start), np.zeros((0, 2))
    square = ((step - np.median(step, axis=0)) ** 2).sum(axis=1)
    for _ in range(_ROUNDS):
        variance = max(float(np.median(square)) / 1.386, _LEAST_VARIANCE)
        weight = (1 + square / (4 * variance)) ** -2
        weighted = (weight[:, None] * rows).T
        coefficients = np.linalg.solve(weighted @ rows + weight.sum() * ridge, weighted @ step)
        square = ((step - rows @ coefficients) ** 2).sum(axis=1)
    return lambda place: np.asarray(basis(place) @ coefficients)
