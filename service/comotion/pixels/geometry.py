"""Key frames and two groups in; what epipolar geometry says of them out.

Under strong perspective an affine view of motion tells near from far parts of one rigid body. One fundamental
matrix per frame pair still explains both, over a wide baseline to within the noise. Two bodies, as a rule, do
not share one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Bools, Floats, Ints
from .key_frames import KeyFrames

Model = Callable[[Floats, Floats, Bools], Callable[[Floats], Floats]]
"""Points [P, n, 2] in both frames of P pairs, and which are seen -> weights [P, n] -> squared residuals."""

# A group is represented by so many of its members in a frame pair.
_POINTS = 50
# Rounds of reweighting in robust fits, and px²; smallest typical squared residual that weights refer to.
_ROUNDS, _LEAST_TYPICAL = 3, 0.01
# Key frames from the first to the second of a near pair, and how many of these are looked at.
_NEAR_STEP, _NEAR_PAIRS = 4, 8
# Fewer key frames show no wide baseline. Wide pairs are half of the key frames apart; one more is of the
# first and the last.
_LEAST_FRAMES, _WIDE_PAIRS = 13, 3
# Points of each group in a near pair: eight are fitted exactly.
_LEAST_POINTS = 9
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
# px² per unit of weight; points on a line still have an affine motion.
_RIDGE_PX2 = 1e-3
# px; a group that moves less in a frame pair rests, if the other moves so many times as far. Of 127
# decisions on the development sequences where this was so, none was between parts of one body.
_RESTING_PX, _TIMES_AS_FAR = 1.5, 10.0
# px; smallest motion that the larger one is compared with: at rest the noise is all there is.
_SLOWEST_PX = 0.2
# nat; log ratio of two groups' joint residual to noise and drift, above which they are two bodies.
_CONTRADICTION = 0.8
# nat; largest log ratios of two groups' joint affine residual to the larger own one, at which parallax within
# them explains that between them, and of their joint epipolar residual to their own, at which they are parts
# of one body; and times this limit from which on one frame pair is enough to contradict.
_PARALLAX_EXCESS, _PARALLAX_EPIPOLAR, _ONE_PAIR_LIMIT = 1.2, 0.2, 4.0


@dataclass(frozen=True)
class Comparison:
    """Two groups in all near frame pairs.

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
        """Median motion in each pair, px."""
        return _median(np.linalg.norm(self.y - self.x, axis=2), self.seen)

    @cached_property
    def epipolar(self) -> Floats:
        """Median squared residual under a fundamental matrix of its own in each pair, px²."""
        return _median(_residuals(_fundamental, self.x, self.y, self.seen.astype(float)), self.seen)

    @cached_property
    def affine(self) -> Floats:
        """Median squared residual under an affine motion of its own in each pair, px²."""
        return _median(_residuals(_affine, self.x, self.y, self.seen.astype(float)), self.seen)

    @cached_property
    def variance(self) -> Floats:
        """Of the Sampson distances under a matrix of its own, px²; of `_LEAST_MEMBERS` points or more."""
        return self.epipolar / _CHI2_MEDIAN_1D * self.count / np.maximum(self.count - _PARAMETERS, 1)

    def joint(self, other: "_Views", rows: Ints, model: Model) -> tuple[Floats, Floats]:
        """Median squared residual of either group when both are fitted together, px², in some pairs."""
        both = [self.x[rows], other.x[rows]], [self.y[rows], other.y[rows]]
        # A large group must not outvote a small one.
        prior = [one.seen[rows] / np.sqrt(one.count[rows, None]) for one in (self, other)]
        square = _residuals(model, *(np.concatenate(part, axis=1) for part in (*both, prior)))
        n = self.seen.shape[1]
        return _median(square[:, :n], self.seen[rows]), _median(square[:, n:], other.seen[rows])


class Geometry:
    """Compares the epipolar geometry of groups, in near pairs of key frames and over wide baselines.

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
        self._near, self._wide = near_pairs(len(self._positions)), wide_pairs(len(self._positions))
        self._views: dict[tuple[bytes, bool], _Views] = {}

    def compare(self, first: Ints, second: Ints) -> Comparison | None:
        """Compare two groups (intp, indices of trajectories) in near pairs; None with too few points."""
        a, b = self._of(first, wide=False), self._of(second, wide=False)
        rows = np.flatnonzero(np.minimum(a.count, b.count) >= _LEAST_POINTS)
        if not len(rows):
            return None
        joint = np.maximum(*a.joint(b, rows, _fundamental))
        own = (a.epipolar[rows] + b.epipolar[rows]) / 2
        return Comparison(float(_log_ratio(joint, own, _EPIPOLAR_FLOOR_PX).mean()), _one_rests(a, b, rows))

    def two_bodies(self, first: Ints, second: Ints) -> bool:
        """Whether no fundamental matrix explains two groups together to within noise and drift."""
        a, b = self._of(first, wide=True), self._of(second, wide=True)
        enough = (np.minimum(a.count, b.count) >= _LEAST_OF_ONE) & (a.count + b.count >= _LEAST_OF_BOTH)
        rows = np.flatnonzero(enough & (self._typical > 0))
        if not len(rows):
            return False
        excess = [
            np.maximum(square / _CHI2_MEDIAN_1D, 1e-12) / self._expected(views)[rows]
            for square, views in zip(a.joint(b, rows, _fundamental), (a, b), strict=True)
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
        a, b = self._of(first, wide=True), self._of(second, wide=True)
        moves = np.maximum(a.motion, b.motion) > _RESTING_PX
        rows = np.flatnonzero((np.minimum(a.count, b.count) >= _LEAST_MEMBERS) & moves)
        # Where both rest, any two bodies look like one.
        if not len(rows) or _one_rests(a, b, rows):
            return False
        own = np.maximum(a.affine[rows], b.affine[rows])
        parallax = _log_ratio(np.maximum(*a.joint(b, rows, _affine)), own, _AFFINE_FLOOR_PX)
        if parallax.mean() > _PARALLAX_EXCESS:
            return False
        excess = np.maximum(
            *(
                _log_ratio(square, _CHI2_MEDIAN_1D * views.variance[rows], _EPIPOLAR_FLOOR_PX)
                for square, views in zip(a.joint(b, rows, _fundamental), (a, b), strict=True)
            )
        )
        return bool(
            excess.mean() < _PARALLAX_EPIPOLAR and excess.max() <= _ONE_PAIR_LIMIT * _PARALLAX_EPIPOLAR
        )

    def _expected(self, views: _Views) -> Floats:
        """Variance of the Sampson distances of a group that a joint fundamental matrix explains, px²."""
        free = np.where(views.count < _LEAST_MEMBERS, 0, views.count - _PARAMETERS)
        variance = (free * views.variance + _PRIOR_STRENGTH * self._typical) / (free + _PRIOR_STRENGTH)
        return np.asarray(variance + (self._drift * views.motion) ** 2)

    @cached_property
    def _typical(self) -> Floats:
        """Median variance of the pieces in each wide pair, px²; 0 where no piece is large enough."""
        large = [self._of(piece, wide=True) for piece in self._pieces if len(piece) >= _LEAST_MEMBERS]
        found = np.zeros(len(self._wide))
        for pair in range(len(found)):
            seen = [views.variance[pair] for views in large if views.count[pair] >= _LEAST_MEMBERS]
            found[pair] = np.median(seen) + 1e-6 if seen else 0.0
        return found

    def _of(self, group: Ints, *, wide: bool) -> _Views:
        key = group.tobytes(), wide
        if key not in self._views:
            pairs = self._wide if wide else self._near
            x, y = np.zeros((2, len(pairs), min(len(group), _POINTS), 2))
            seen = np.zeros(x.shape[:2], np.bool_)
            for k, (first, second) in enumerate(pairs):
                there = group[self._visible[first, group] & self._visible[second, group]]
                if len(there) > _POINTS:
                    there = there[(np.arange(_POINTS) * len(there)) // _POINTS]
                x[k, : len(there)], y[k, : len(there)] = self._positions[[first, second]][:, there]
                seen[k, : len(there)] = True
            self._views[key] = _Views(x, y, seen)
        return self._views[key]


def near_pairs(count: int) -> list[tuple[int, int]]:
    """Pairs of `count` key frames, from the newest on: its motion must not be missed, it may be all."""
    step = min(_NEAR_STEP, max(count - 1, 1))
    every = max(1, -(-(count - step) // _NEAR_PAIRS))
    return [(t - step, t) for t in range(count - 1, step - 1, -every)]


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


def _median(values: Floats, seen: Bools) -> Floats:
    """Median of those that are seen, [P]; 0 of none."""
    ranked, count = np.sort(np.where(seen, values, np.inf), axis=1), seen.sum(axis=1)
    low, high = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, seen.shape[1] - 1)
    middle = np.take_along_axis(ranked, np.stack([low, high], axis=1), axis=1).mean(axis=1)
    return np.where(count > 0, middle, 0.0)


def _residuals(model: Model, x: Floats, y: Floats, prior: Floats) -> Floats:
    """Squared residuals [P, n] under reweighted fits; `prior` [P, n] weighs points, 0 where there is none."""
    seen = prior > 0
    fit, weight = model(x, y, seen), prior
    square = fit(weight)
    for _ in range(_ROUNDS - 1):
        typical = np.maximum(_median(square, seen), _LEAST_TYPICAL)[:, None]
        square = fit(prior / np.sqrt(1 + square / (4 * typical)))
    return square


def _fundamental(x: Floats, y: Floats, seen: Bools) -> Callable[[Floats], Floats]:
    """Squared Sampson distances under the normalised eight-point method (Hartley 1997)."""
    (p, u, left), (q, v, right) = _normalised(x, seen), _normalised(y, seen)
    rows = (v[..., :, None] * u[..., None, :]).reshape(*seen.shape, 9)

    def squares(weight: Floats) -> Floats:
        scaled = rows * weight[..., None]
        vector = np.linalg.eigh(scaled.mT @ scaled)[1][..., 0]
        a, s, b = np.linalg.svd(vector.reshape(-1, 3, 3))
        s[:, 2] = 0
        matrix = right.mT @ (a * s[:, None] @ b) @ left
        there, back = p @ matrix.mT, q @ matrix
        gradient = (there[..., :2] ** 2).sum(axis=2) + (back[..., :2] ** 2).sum(axis=2)
        return np.asarray((q * there).sum(axis=2) ** 2 / np.maximum(gradient, 1e-12))

    return squares


def _affine(x: Floats, y: Floats, seen: Bools) -> Callable[[Floats], Floats]:
    """Squared distances from an affine motion."""
    _, rows, normalising = _normalised(x, seen)
    move = y - x
    # The ridge holds the linear part, per px of place; `rows` are scaled.
    ridge = _RIDGE_PX2 * normalising[:, 0, 0, None, None] ** 2 * np.diag([1.0, 1.0, 0.0])

    def squares(weight: Floats) -> Floats:
        weighted = (rows * weight[..., None]).mT
        normal = weighted @ rows + weight.sum(axis=1)[:, None, None] * ridge + 1e-9 * np.eye(3)
        field = np.linalg.solve(normal, weighted @ move)
        return np.asarray(((move - rows @ field) ** 2).sum(axis=2))

    return squares


def _normalised(x: Floats, seen: Bools) -> tuple[Floats, Floats, Floats]:
    """Homogeneous points [P, n, 3], the same at mean distance √2 from 0, and the matrix for it [P, 3, 3]."""
    count = np.maximum(seen.sum(axis=1), 1)[:, None]
    centre = (x * seen[..., None]).sum(axis=1) / count
    apart = np.linalg.norm(x - centre[:, None], axis=2) * seen
    scale = np.sqrt(2) / np.maximum(apart.sum(axis=1) / count[:, 0], 1e-9)
    matrix = np.zeros((len(x), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = scale
    matrix[:, :2, 2] = -scale[:, None] * centre
    matrix[:, 2, 2] = 1
    points = np.concatenate([x, np.ones((*seen.shape, 1))], axis=2)
    return points, points @ matrix.mT, matrix
