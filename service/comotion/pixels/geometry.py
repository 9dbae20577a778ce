"""Compares groups by epipolar geometry on key frames: whether two are parts of one body, or two bodies.

Under strong perspective an affine view of motion tells near from far parts of one rigid body. One fundamental
matrix per frame pair still explains both, over a wide baseline to within the noise. Two bodies, as a rule, do
not share one.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Bools, Floats, Ints
from .consensus import consensus
from .fits import Model, affine, fundamental, residuals
from .key_frames import KeyFrames
from .medians import median

# A group is represented by so many of its members in a frame pair.
_POINTS = 50
# Fewer key frames show no wide baseline. Wide pairs are half of the key frames apart; one more is of the
# first and the last.
_LEAST_FRAMES, _WIDE_PAIRS = 13, 3
# Members of a group that tell how noisy it is, and whether it has parallax; and of each and of both that a
# joint residual over a wide baseline is formed of.
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
# px; a group that moves less in a frame pair rests, if the other moves so many times as far. Of 127
# decisions on the development sequences where this was so, none was between parts of one body.
_RESTING_PX, _TIMES_AS_FAR = 1.5, 10.0
# px; smallest motion that the larger one is compared with: at rest the noise is all there is.
_SLOWEST_PX = 0.2
# nat; log ratio of two groups' joint residual to noise and drift, above which they are two bodies.
_CONTRADICTION = 0.8
# nat; largest log ratios of two groups' joint affine residual to the larger own one, at which parallax within
# them explains that between them, and of their joint epipolar residual to their own, at which they are parts
# of one body.
_PARALLAX_EXCESS, _PARALLAX_EPIPOLAR = 1.2, 0.2


@dataclass(frozen=True)
class _Views:
    """A group in P frame pairs: its points float64 [P, n, 2] in both, and which there are, bool [P, n]."""

    x: Floats
    y: Floats
    seen: Bools

    @cached_property
    def count(self) -> Ints:
        """Points in each pair."""
        return np.asarray(self.seen.sum(axis=1))

    @cached_property
    def motion(self) -> Floats:
        """Median motion in each pair, px; NaN of none, as below."""
        return median(np.where(self.seen, np.linalg.norm(self.y - self.x, axis=2), np.nan), 1)

    @cached_property
    def epipolar(self) -> Floats:
        """Median squared residual under a fundamental matrix of its own in each pair, px²."""
        return median(residuals(fundamental, self.x, self.y, self.seen.astype(float)), 1)

    @cached_property
    def affine(self) -> Floats:
        """Median squared residual under an affine motion of its own in each pair, px²."""
        return median(residuals(affine, self.x, self.y, self.seen.astype(float)), 1)

    @cached_property
    def variance(self) -> Floats:
        """Of the Sampson distances under a matrix of its own, px²; of `_LEAST_MEMBERS` points or more."""
        return self.epipolar / _CHI2_MEDIAN_1D * self.count / np.maximum(self.count - _PARAMETERS, 1)

    def joint(self, other: "_Views", rows: Ints, model: Model) -> tuple[Floats, Floats]:
        """Median squared residual of either group when both are fitted together, px², in some pairs."""
        points = [self.x[rows], other.x[rows]], [self.y[rows], other.y[rows]]
        # A large group must not outvote a small one.
        prior = [views.seen[rows] / np.sqrt(views.count[rows, None]) for views in (self, other)]
        square = residuals(model, *(np.concatenate(part, axis=1) for part in (*points, prior)))
        n = self.seen.shape[1]
        return median(square[:, :n], 1), median(square[:, n:], 1)


class Geometry:
    """Compares the epipolar geometry of groups: of the pieces by consensus, of any over wide baselines.

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
        self._frames = frames
        self._positions = frames.positions.astype(np.float64)
        self._visible = frames.visible
        self._pieces = pieces
        self._drift = drift
        self._wide = wide_pairs(len(self._positions))
        self._views: dict[bytes, _Views] = {}

    @cached_property
    def consensus(self) -> Floats:
        """How alike the pieces rank epipolar geometries, [P, P]; the draw is fixed."""
        return consensus(self._frames, self._pieces, np.random.default_rng(0))

    def two_bodies(self, first: Ints, second: Ints) -> bool:
        """Whether no fundamental matrix explains two groups together to within noise and drift."""
        a, b = self._of(first), self._of(second)
        enough = (np.minimum(a.count, b.count) >= _LEAST_OF_ONE) & (a.count + b.count >= _LEAST_OF_BOTH)
        rows = np.flatnonzero(enough & (self._typical > 0))
        if not len(rows):
            return False
        excess = [
            np.maximum(square / _CHI2_MEDIAN_1D, 1e-12) / self._expected(views)[rows]
            for square, views in zip(a.joint(b, rows, fundamental), (a, b), strict=True)
        ]
        return bool(0.5 * np.log(np.maximum(*excess)).mean() > _CONTRADICTION)

    def one_body(self, first: Ints, second: Ints) -> bool:
        """Whether two groups are clearly parts of one body with depth.

        They share a fundamental matrix over wide baselines, and a group shows parallax already within itself,
        not much less than there is between the two. This is needed because two bodies without parallax of
        their own that only translate share a fundamental matrix too. It joins parts of a scene in strong
        perspective, whose image motions differ as those of two bodies do.
        """
        if min(len(first), len(second)) < _LEAST_MEMBERS:
            return False
        a, b = self._of(first), self._of(second)
        moves = np.maximum(a.motion, b.motion) > _RESTING_PX
        rows = np.flatnonzero((np.minimum(a.count, b.count) >= _LEAST_MEMBERS) & moves)
        # Where both rest, any two bodies look like one.
        if not len(rows) or _one_rests(a, b, rows):
            return False
        own = np.maximum(a.affine[rows], b.affine[rows])
        parallax = _log_ratio(np.maximum(*a.joint(b, rows, affine)), own, _AFFINE_FLOOR_PX)
        if parallax.mean() > _PARALLAX_EXCESS:
            return False
        excess = np.maximum(
            *(
                _log_ratio(square, _CHI2_MEDIAN_1D * views.variance[rows], _EPIPOLAR_FLOOR_PX)
                for square, views in zip(a.joint(b, rows, fundamental), (a, b), strict=True)
            )
        )
        return bool(excess.mean() < _PARALLAX_EPIPOLAR)

    def _expected(self, views: _Views) -> Floats:
        """Variance of the Sampson distances of a group that a joint fundamental matrix explains, px²."""
        freedom = np.where(views.count < _LEAST_MEMBERS, 0, views.count - _PARAMETERS)
        variance = (freedom * views.variance + _PRIOR_STRENGTH * self._typical) / (freedom + _PRIOR_STRENGTH)
        return np.asarray(variance + (self._drift * views.motion) ** 2)

    @cached_property
    def _typical(self) -> Floats:
        """Median variance of the pieces in each wide pair, px²; 0 where no piece is large enough."""
        large = [self._of(piece) for piece in self._pieces if len(piece) >= _LEAST_MEMBERS]
        typical = np.zeros(len(self._wide))
        for pair in range(len(typical)):
            seen = [views.variance[pair] for views in large if views.count[pair] >= _LEAST_MEMBERS]
            typical[pair] = np.median(seen) + 1e-6 if seen else 0.0
        return typical

    def _of(self, group: Ints) -> _Views:
        key = group.tobytes()
        if key not in self._views:
            x, y = np.zeros((2, len(self._wide), min(len(group), _POINTS), 2))
            seen = np.zeros(x.shape[:2], np.bool_)
            for k, (first, second) in enumerate(self._wide):
                members = group[self._visible[first, group] & self._visible[second, group]]
                if len(members) > _POINTS:
                    members = members[(np.arange(_POINTS) * len(members)) // _POINTS]
                x[k, : len(members)], y[k, : len(members)] = self._positions[[first, second]][:, members]
                seen[k, : len(members)] = True
            self._views[key] = _Views(x, y, seen)
        return self._views[key]


def wide_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of key frames that are half of `count` apart, and the first and the last; none of too few."""
    if count < _LEAST_FRAMES:
        return []
    half = count // 2
    ends = np.unique(np.round(np.linspace(half, count - 1, _WIDE_PAIRS)).astype(int)).tolist()
    return [(end - half, end) for end in ends] + [(0, count - 1)]


def _log_ratio(square: Floats, own: Floats, floor_px: float) -> Floats:
    return np.log((np.sqrt(square) + floor_px) / (np.sqrt(own) + floor_px))


def _one_rests(a: _Views, b: _Views, rows: Ints) -> bool:
    """Whether in one of some pairs one group rests while the other moves."""
    slow, fast = np.minimum(a.motion, b.motion)[rows], np.maximum(a.motion, b.motion)[rows]
    return bool(((slow < _RESTING_PX) & (fast > _TIMES_AS_FAR * np.maximum(slow, _SLOWEST_PX))).any())
