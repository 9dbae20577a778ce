"""Compares groups over wide baselines: whether two are parts of one body, or two bodies.

Under strong perspective an affine view of motion tells near from far parts of one rigid body. One fundamental
matrix per frame pair still explains both, to within the noise. Two bodies, as a rule, do not share one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Floats, Ints
from .kernels.epipolar import fundamental, sampson
from .key_frames import KeyFrames, evenly_spaced

# Members that represent a group in a frame pair.
_POINTS = 50
# Fewer key frames show no wide baseline. Wide pairs are half of the key frames apart; one more is of the
# first and the last.
_LEAST_FRAMES, _WIDE_PAIRS = 13, 3
# Members of a group that tell how noisy it is, and whether it has parallax; and of each and of both that a
# joint residual is formed of.
_LEAST_MEMBERS, _LEAST_OF_ONE, _LEAST_OF_BOTH = 12, 5, 12
# Parameters of a fundamental matrix: so many points are fitted by chance.
_PARAMETERS = 7
# Median of a squared standard normal deviate.
_CHI2_MEDIAN_1D = 0.455
# Rounds of reweighting in robust fits, and px²; smallest typical squared residual that weights refer to.
_ROUNDS, _LEAST_TYPICAL = 3, 0.01
# px; added to residuals so that the ratio of two tiny ones does not decide: of fundamental matrices, and of
# affine motions.
_EPIPOLAR_FLOOR_PX, _AFFINE_FLOOR_PX = 0.05, 0.3
# px; where a group moves less in a frame pair, any two bodies look like one.
_RESTING_PX = 1.5
# nat; log ratio of two groups' joint residual to noise and drift, above which they are two bodies.
_CONTRADICTION = 0.8
# nat; largest log ratios of two groups' joint affine residual to the larger own one, at which parallax within
# them explains that between them, and of their joint epipolar residual to their own, at which they are parts
# of one body.
_PARALLAX_EXCESS, _PARALLAX_EPIPOLAR = 1.2, 0.2

Model = Callable[[Floats, Floats, Floats], Floats]
"""Points [n, 2] in both frames and weights [n] -> squared residuals [n] under a fit, px²."""


def epipolar_squares(x: Floats, y: Floats, weight: Floats) -> Floats:
    """Squared Sampson distances from a fundamental matrix."""
    return sampson(fundamental(x, y, weight), x, y)


def affine_squares(x: Floats, y: Floats, weight: Floats) -> Floats:
    """Squared distances from an affine motion."""
    rows, root = np.column_stack([x - x.mean(axis=0), np.ones(len(x))]), np.sqrt(weight)[:, None]
    field = np.linalg.lstsq(root * rows, root * (y - x))[0]
    return np.asarray(((y - x - rows @ field) ** 2).sum(axis=1))


def _residuals(model: Model, x: Floats, y: Floats, weight: Floats) -> Floats:
    """Squared residuals [n] under a robust fit."""
    square = model(x, y, weight)
    for _ in range(_ROUNDS - 1):
        typical = max(np.median(square), _LEAST_TYPICAL)
        square = model(x, y, weight / np.sqrt(1 + square / (4 * typical)))
    return square


@dataclass(frozen=True)
class _View:
    """A group in a pair of frames: its points, float64 [n, 2], in both."""

    x: Floats
    y: Floats

    def __len__(self) -> int:
        return len(self.x)

    @cached_property
    def motion(self) -> float:
        """Median motion, px."""
        return float(np.median(np.linalg.norm(self.y - self.x, axis=1)))

    def own(self, model: Model) -> float:
        """Median squared residual under a fit of its own, px²."""
        return float(np.median(_residuals(model, self.x, self.y, np.ones(len(self)))))

    @cached_property
    def affine(self) -> float:
        """Median squared residual under an affine motion of its own, px²."""
        return self.own(affine_squares)

    @cached_property
    def variance(self) -> float:
        """Of the Sampson distances under a matrix of its own, px²; of `_LEAST_MEMBERS` points or more."""
        return self.own(epipolar_squares) / _CHI2_MEDIAN_1D * len(self) / (len(self) - _PARAMETERS)

    def expected(self, typical: float, drift: float) -> float:
        """Variance of the Sampson distances under a matrix that explains it, px², typical of a few."""
        variance = self.variance if len(self) >= _LEAST_MEMBERS else typical
        return variance + (drift * self.motion) ** 2


def _joint(model: Model, a: _View, b: _View) -> tuple[float, float]:
    """Median squared residual of either group when both are fitted together, px²."""
    # A large group must not outvote a small one.
    weight = np.repeat([len(a) ** -0.5, len(b) ** -0.5], [len(a), len(b)])
    square = _residuals(model, np.concatenate([a.x, b.x]), np.concatenate([a.y, b.y]), weight)
    return float(np.median(square[: len(a)])), float(np.median(square[len(a) :]))


class Geometry:
    """Compares the epipolar geometry of groups over wide baselines.

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
        self._positions, self._visible = frames.positions.astype(np.float64), frames.visible
        self._pieces = pieces
        self._drift = drift
        self._wide = wide_pairs(len(self._positions))
        self._views: dict[bytes, list[_View]] = {}

    def two_bodies(self, first: Ints, second: Ints) -> bool:
        """Whether no fundamental matrix explains two groups together to within noise and drift."""
        excess = []
        for a, b, typical in zip(self._of(first), self._of(second), self._typical, strict=True):
            if typical and min(len(a), len(b)) >= _LEAST_OF_ONE and len(a) + len(b) >= _LEAST_OF_BOTH:
                pairs = zip(_joint(epipolar_squares, a, b), (a, b), strict=True)
                ratios = [square / view.expected(typical, self._drift) for square, view in pairs]
                excess.append(max(*ratios, 1e-12) / _CHI2_MEDIAN_1D)
        return bool(excess) and bool(0.5 * np.log(excess).mean() > _CONTRADICTION)

    def one_body(self, first: Ints, second: Ints) -> bool:
        """Whether two groups are clearly parts of one body with depth.

        They share a fundamental matrix over wide baselines, and a group shows parallax already within itself,
        not much less than there is between the two. This is needed because two bodies without parallax of
        their own that only translate share a fundamental matrix too. It joins parts of a scene in strong
        perspective, whose image motions differ as those of two bodies do.
        """
        if min(len(first), len(second)) < _LEAST_MEMBERS:
            return False
        parallax, excess = [], []
        for a, b in zip(self._of(first), self._of(second), strict=True):
            if min(len(a), len(b)) >= _LEAST_MEMBERS and min(a.motion, b.motion) > _RESTING_PX:
                own = max(a.affine, b.affine)
                parallax.append(_log_ratio(max(_joint(affine_squares, a, b)), own, _AFFINE_FLOOR_PX))
                ratios = (
                    _log_ratio(square, _CHI2_MEDIAN_1D * view.variance, _EPIPOLAR_FLOOR_PX)
                    for square, view in zip(_joint(epipolar_squares, a, b), (a, b), strict=True)
                )
                excess.append(max(ratios))
        shown = bool(excess) and np.mean(parallax) <= _PARALLAX_EXCESS
        return bool(shown and np.mean(excess) < _PARALLAX_EPIPOLAR)

    @cached_property
    def _typical(self) -> list[float]:
        """Median variance of the pieces in each wide pair, px²; 0 where no piece is large enough."""
        views = [self._of(piece) for piece in self._pieces if len(piece) >= _LEAST_MEMBERS]
        seen = [[v[k].variance for v in views if len(v[k]) >= _LEAST_MEMBERS] for k in range(len(self._wide))]
        return [float(np.median(variances)) + 1e-6 if variances else 0.0 for variances in seen]

    def _of(self, group: Ints) -> list[_View]:
        key = group.tobytes()
        if key not in self._views:
            self._views[key] = []
            for first, second in self._wide:
                members = group[self._visible[first, group] & self._visible[second, group]]
                members = members[evenly_spaced(len(members), _POINTS)]
                self._views[key].append(_View(*self._positions[[first, second]][:, members]))
        return self._views[key]


def wide_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of key frames that are half of `count` apart, and the first and the last; none of too few."""
    if count < _LEAST_FRAMES:
        return []
    half = count // 2
    starts = evenly_spaced(count - half, _WIDE_PAIRS).tolist()
    return [(start, start + half) for start in starts] + [(0, count - 1)]


def _log_ratio(square: float, own: float, floor_px: float) -> float:
    return float(np.log((np.sqrt(square) + floor_px) / (np.sqrt(own) + floor_px)))
