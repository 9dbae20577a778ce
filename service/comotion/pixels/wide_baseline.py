"""Key frames and two groups in; what epipolar geometry over wide baselines says of them out.

Over a wide baseline parts of one rigid body share a fundamental matrix to within the noise, and most bodies
that move apart do not. Two rules follow:

- Two groups whose joint residual is well above the noise are two bodies.
- Two groups that share a fundamental matrix are one body with depth, if a group shows parallax already within
  itself, not much less than there is between the two. This is needed because two bodies without parallax of
  their own that only translate share a fundamental matrix too. It joins parts of a scene in strong
  perspective, whose image motions differ as those of two bodies do.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Floats, Ints
from .epipolar import RESTING_PX, one_rests, thinned
from .kernels.epipolar import residual_alone, residuals_joint
from .kernels.robust_affine import affine_residual_alone, affine_residuals_joint
from .key_frames import KeyFrames

# Fewer key frames show no wide baseline.
_LEAST_FRAMES = 13
# Pairs that are half of the key frames apart; one more is of the first and the last.
_HALF_PAIRS = 3
# Members of a group that tell how noisy it is, and whether it has parallax; and of each and of both that a
# joint residual is formed of.
_LEAST_MEMBERS, _LEAST_OF_ONE, _LEAST_OF_BOTH = 12, 5, 12
# Parameters of a fundamental matrix: so many points are fitted by chance.
_PARAMETERS = 7
# Observations that the noise of all groups counts for beside that of one.
_PRIOR_STRENGTH = 20.0
# Median of a squared standard normal deviate.
_CHI2_MEDIAN_1D = 0.455
# px; added to residuals so that the ratio of two tiny ones does not decide: of fundamental matrices, and of
# affine motions.
_EPIPOLAR_FLOOR_PX, _AFFINE_FLOOR_PX = 0.05, 0.3
# nat; log ratio of two groups' joint residual to noise and drift, above which they are two bodies.
_CONTRADICTION = 0.8
# nat; largest log ratios of two groups' joint affine residual to the larger own one, at which parallax within
# them explains that between them, and of their joint epipolar residual to their own, at which they are parts
# of one body.
_PARALLAX_EXCESS, _PARALLAX_EPIPOLAR = 1.2, 0.2
# Times the limit from which on one frame pair is enough to contradict.
_ONE_PAIR_LIMIT = 4.0


@dataclass(frozen=True)
class _View:
    """A group in a frame pair: its points float64 [n, 2] in both."""

    x: Floats
    y: Floats

    @cached_property
    def variance(self) -> float:
        """Of the Sampson distances under a fundamental matrix of its own, px²; needs `_LEAST_MEMBERS`."""
        square, _ = residual_alone(self.x, self.y)
        return square / _CHI2_MEDIAN_1D * len(self.x) / (len(self.x) - _PARAMETERS)

    @cached_property
    def motion(self) -> float:
        """Median motion, px."""
        return float(np.median(np.hypot(*(self.y - self.x).T)))

    @cached_property
    def affine(self) -> float:
        """Residual under an affine motion of its own, px."""
        return math.sqrt(affine_residual_alone(self.x, self.y)) + _AFFINE_FLOOR_PX


class WideBaselineTest:
    """Tells parts of one body from two bodies by their epipolar geometry over wide baselines.

    Parameters
    ----------
    frames
        Key frames of all trajectories.
    pieces
        Groups (intp, indices of trajectories) of one body each; the noise is learnt from them.
    drift
        Share of a motion by which features drift or a lens distorts it.
    """

    def __init__(self, frames: KeyFrames, pieces: list[Ints], drift: float) -> None:
        self._positions = frames.positions.astype(np.float64)
        self._visible = frames.visible
        self._pieces = pieces
        self._drift = drift
        self._pairs = wide_pairs(len(self._positions))
        self._views: dict[bytes, list[_View]] = {}

    def two_bodies(self, first: Ints, second: Ints) -> bool:
        """Whether no fundamental matrix explains two groups together to within noise and drift."""
        found = [
            self._excess_over_noise(a, b, typical)
            for a, b, typical in zip(self._of(first), self._of(second), self._typical, strict=True)
            if min(len(a.x), len(b.x)) >= _LEAST_OF_ONE and len(a.x) + len(b.x) >= _LEAST_OF_BOTH and typical
        ]
        return bool(found) and float(np.mean(found)) > _CONTRADICTION

    def one_body(self, first: Ints, second: Ints) -> bool:
        """Whether two groups are clearly parts of one body with depth."""
        if min(len(first), len(second)) < _LEAST_MEMBERS:
            return False
        views = [
            (a, b)
            for a, b in zip(self._of(first), self._of(second), strict=True)
            if min(len(a.x), len(b.x)) >= _LEAST_MEMBERS and max(a.motion, b.motion) > RESTING_PX
        ]
        # Where both rest, any two bodies look like one.
        if not views or any(one_rests(a.motion, b.motion) for a, b in views):
            return False
        if np.mean([_affine_excess(a, b) for a, b in views]) > _PARALLAX_EXCESS:
            return False
        return self._share_geometry(views)

    def _share_geometry(self, views: list[tuple[_View, _View]]) -> bool:
        found = []
        for a, b in views:
            found.append(_epipolar_excess(a, b))
            if found[-1] > _ONE_PAIR_LIMIT * _PARALLAX_EPIPOLAR:
                return False
        return bool(np.mean(found) < _PARALLAX_EPIPOLAR)

    def _excess_over_noise(self, a: _View, b: _View, typical: float) -> float:
        """Log of the joint residual over what noise and drift explain, of the group where it is larger."""
        joint = residuals_joint(a.x, a.y, b.x, b.y)
        return 0.5 * max(
            math.log(max(square / _CHI2_MEDIAN_1D, 1e-12) / self._expected(view, typical))
            for square, view in zip(joint, (a, b), strict=True)
        )

    def _expected(self, view: _View, typical: float) -> float:
        """Variance of the Sampson distances of a group that a joint fundamental matrix explains, px²."""
        drift = (self._drift * view.motion) ** 2
        if len(view.x) < _LEAST_MEMBERS:
            return typical + drift
        free = len(view.x) - _PARAMETERS
        return (free * view.variance + _PRIOR_STRENGTH * typical) / (free + _PRIOR_STRENGTH) + drift

    @cached_property
    def _typical(self) -> list[float]:
        """Median variance of the pieces in each frame pair, px²; 0 where no piece is large enough."""
        seen: list[list[float]] = [[] for _ in self._pairs]
        for piece in self._pieces:
            if len(piece) >= _LEAST_MEMBERS:
                for variances, view in zip(seen, self._of(piece), strict=True):
                    if len(view.x) >= _LEAST_MEMBERS:
                        variances.append(view.variance)
        return [float(np.median(v)) + 1e-6 if v else 0.0 for v in seen]

    def _of(self, group: Ints) -> list[_View]:
        key = group.tobytes()
        if key not in self._views:
            self._views[key] = [self._view(group, *pair) for pair in self._pairs]
        return self._views[key]

    def _view(self, group: Ints, first: int, second: int) -> _View:
        seen = thinned(group[self._visible[first, group] & self._visible[second, group]])
        return _View(self._positions[first, seen], self._positions[second, seen])


def wide_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of key frames that are half of `count` apart, and the first and the last; none of too few."""
    if count < _LEAST_FRAMES:
        return []
    half = count // 2
    ends = np.unique(np.round(np.linspace(half, count - 1, _HALF_PAIRS)).astype(int)).tolist()
    return [(end - half, end) for end in ends] + [(0, count - 1)]


def _affine_excess(a: _View, b: _View) -> float:
    """Logarithm of the residual of one affine motion for both, over the larger residual of a group's own."""
    joint = math.sqrt(max(affine_residuals_joint(a.x, a.y, b.x, b.y))) + _AFFINE_FLOOR_PX
    return math.log(joint / max(a.affine, b.affine))


def _epipolar_excess(a: _View, b: _View) -> float:
    """Logarithm of the residual of one fundamental matrix for both over the own one, of the worse group."""
    joint = residuals_joint(a.x, a.y, b.x, b.y)
    return max(
        math.log((math.sqrt(square) + _EPIPOLAR_FLOOR_PX) / (math.sqrt(own) + _EPIPOLAR_FLOOR_PX))
        for square, own in zip(
            joint, (_CHI2_MEDIAN_1D * a.variance, _CHI2_MEDIAN_1D * b.variance), strict=True
        )
    )
