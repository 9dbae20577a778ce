"""Key frames and two groups in; whether the groups share one epipolar geometry out.

Under strong perspective an affine view of motion tells near from far parts of one rigid body. One
fundamental matrix per frame pair still explains both. Two bodies, as a rule, do not share one.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import Floats, Ints
from .kernels.epipolar import residual_alone, residuals_joint
from .key_frames import KeyFrames

# Eight points are fitted exactly.
_LEAST_POINTS = 9
# Key frames from the first to the second of a pair, and how many pairs are looked at.
_PAIR_STEP = 4
_PAIRS = 8
# A group is represented by so many of its members in a pair.
_POINTS = 50
# px; added to residuals so that the ratio of two tiny ones does not decide.
_FLOOR_PX = 0.05
# A group that moves less than this in a frame pair rests, if the other moves so many times as far. Of 127
# decisions on the development sequences where this was so, none was between parts of one body.
RESTING_PX = 1.5
_TIMES_AS_FAR = 10.0
# px; smallest motion that the larger one is compared with: at rest the noise is all there is.
_SLOWEST_PX = 0.2


@dataclass(frozen=True)
class EpipolarComparison:
    """Two groups in all frame pairs.

    Attributes
    ----------
    log_ratio
        Mean of log(joint / own residual). Residuals are medians of the Sampson distance, px; the
        joint one is the larger of the two groups' medians.
    one_rests
        Whether in some frame pair one group rests in the image while the other moves: then the
        camera rests too, and what moves is another body. The residuals do not show that, because a
        geometry that fits a translation fits points at rest.
    """

    log_ratio: float
    one_rests: bool


class _Own(NamedTuple):
    """A group in a frame pair: its points [n, 2] in both, own squared residual px², median motion px."""

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
        step = min(_PAIR_STEP, max(count - 1, 1))
        # The newest motion must not be missed: it may be all that there is.
        ends = range(count - 1, step - 1, -max(1, -(-(count - step) // _PAIRS)))
        self._pairs = [(t - step, t) for t in ends]
        self._alone: dict[bytes, list[_Own]] = {}

    def compare(self, first: Ints, second: Ints) -> EpipolarComparison | None:
        """Compare two groups (intp, indices of trajectories); None where too few points are seen."""
        pairs = [
            (a, b)
            for a, b in zip(self._own(first), self._own(second), strict=True)
            if min(len(a.x), len(b.x)) >= _LEAST_POINTS
        ]
        if not pairs:
            return None
        log_ratio = float(np.mean([_log_ratio(a, b) for a, b in pairs]))
        return EpipolarComparison(log_ratio, any(one_rests(a.motion, b.motion) for a, b in pairs))

    def _own(self, group: Ints) -> list[_Own]:
        key = group.tobytes()
        if key not in self._alone:
            self._alone[key] = [self._fit(group, *pair) for pair in self._pairs]
        return self._alone[key]

    def _fit(self, group: Ints, first: int, second: int) -> _Own:
        seen = thinned(group[self._visible[first, group] & self._visible[second, group]])
        x, y = self._positions[first, seen], self._positions[second, seen]
        if len(seen) < _LEAST_POINTS:
            return _Own(x, y, 0.0, 0.0)
        return _Own(x, y, *residual_alone(x, y))


def _log_ratio(a: _Own, b: _Own) -> float:
    joint = max(residuals_joint(a.x, a.y, b.x, b.y))
    alone = (a.residual + b.residual) / 2
    return math.log((math.sqrt(joint) + _FLOOR_PX) / (math.sqrt(alone) + _FLOOR_PX))


def thinned(group: Ints) -> Ints:
    """Members that represent a group in a frame pair, evenly spread."""
    return group if len(group) <= _POINTS else group[(np.arange(_POINTS) * len(group)) // _POINTS]


def one_rests(first: float, second: float) -> bool:
    """Whether of two groups that move so far, px, one rests while the other moves."""
    slow, fast = min(first, second), max(first, second)
    return slow < RESTING_PX and fast > _TIMES_AS_FAR * max(slow, _SLOWEST_PX)
