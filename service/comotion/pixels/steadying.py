"""Subtracts the motion of the background from that of all trajectories, before a camera that moves.

The background moves by a smooth field, plus the parallax of what is nearer or farther than its surroundings.
Parallax lies along lines through one point, the epipole (Irani and Anandan 1998), and a trajectory has the
same share of it at any time. So what rests in the world needs little tolerance across these lines, and along
them as much as it has needed before. All constants were chosen on made-up scenes of docs/research/pixels.md.
"""

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from ..arrays import Bools, Floats, Ints, Slots, Stamps
from .recent import Recent

# Trajectories of the background without which its motion is unknown.
_LEAST_BACKGROUND = 12
# Columns and rows of the grid of bumps that the field has beside its quadratic part; ridges of the linear
# part, of the quadratic one and of the bumps, in trajectories; rounds of reweighting, the first two plain.
_GRID, _RIDGES = (6, 4), (1e-3, 1e-2, 0.1)
_ROUNDS, _PLAIN_ROUNDS = 5, 2
# px²; smallest typical squared residual that weights refer to. Rounds of the fit of the epipole.
_LEAST_TYPICAL, _EPIPOLE_ROUNDS = 0.05, 4
# Standard deviations of the noise up to which a residual tells more about the epipole, the longer it is.
_CLEAR = 5.0
# Share of the background whose parallax is the usual one: others may move.
_QUANTILE = 0.8
_CHI2_MEDIAN, _CHI2_QUANTILE, _CHI2_MEDIAN_2D = chdtri(1, 0.5), chdtri(1, 1 - _QUANTILE), chdtri(2, 0.5)
# Squared parallax of a newborn trajectory, in the usual one, which is also the most; how fast it follows what
# is seen, per step, and over which time scale; and what it is multiplied by for a tolerance.
_NEWBORN, _FOLLOWS, _SCALE, _TOLERANCE = 4.0, 0.15, 1, 2.0


class Steadying:
    """Follows the parallax of each slot of a window.

    Attributes
    ----------
    spread
        px²; variance of a coordinate of the background about its smooth motion over a quarter of a second, at
        the last call; infinite where that is unknown.
    """

    def __init__(self) -> None:
        self.spread = np.inf
        self._keys: Stamps = np.zeros(0, np.int64)
        # Squared, in that of the background.
        self._parallax: Floats = np.zeros(0)

    def steadied(self, recent: Recent, keys: Stamps, members: Bools) -> Recent:
        """Displacements relative to those of the background, with its variance about them.

        Parameters
        ----------
        recent
            Of n trajectories.
        keys
            int64 [capacity]; stable numbers of the trajectories of all slots.
        members
            bool [n]; the background.
        """
        own, self.spread = self._parallax_of(recent.slots, keys), np.inf
        displacement, tolerance = recent.displacement.copy(), np.full(recent.seen.shape, np.inf)
        for scale, seen in enumerate(recent.seen):
            rows = np.flatnonzero(seen & members)
            if len(rows) < _LEAST_BACKGROUND:
                continue
            start = recent.position - displacement[scale]
            residual = displacement[scale] - _field(start, displacement[scale], rows)
            # Of a displacement, which has the noise of both its ends.
            noise = 2 * float(np.median(recent.variance[rows]))
            along, across = _squares(start, residual, rows, noise)
            usual = _variance(along[rows], _QUANTILE, _CHI2_QUANTILE, noise)
            least = _variance(along[rows], 0.5, _CHI2_MEDIAN, noise)
            rigid = _variance(across[rows], 0.5, _CHI2_MEDIAN, noise)
            share = along / np.maximum(along + across, 1e-12)
            tolerance[scale] = share * np.maximum(least, _TOLERANCE * own * usual) + (1 - share) * rigid
            displacement[scale] = residual
            if scale == _SCALE:
                self.spread = float(np.median(along[rows] + across[rows])) / _CHI2_MEDIAN_2D
                if usual > 0:
                    own[rows] += _FOLLOWS * (np.minimum(along[rows] / (usual + noise), _NEWBORN) - own[rows])
        self._parallax[recent.slots] = own
        return replace(recent, displacement=displacement, tolerance=tolerance)

    def _parallax_of(self, slots: Slots, keys: Stamps) -> Floats:
        extra = len(keys) - len(self._keys)
        self._keys = np.append(self._keys, np.full(extra, -1))
        self._parallax = np.append(self._parallax, np.zeros(extra))
        fresh = slots[self._keys[slots] != keys[slots]]
        self._parallax[fresh], self._keys[fresh] = _NEWBORN, keys[fresh]
        return self._parallax[slots]


def _variance(squares: Floats, share: float, expected: float, noise: float) -> float:
    """Variance beyond the noise, by a quantile of squares, which is `expected` at variance 1."""
    return max(float(np.quantile(squares, share)) / expected - noise, 0.0)


def _field(start: Floats, step: Floats, rows: Ints) -> Floats:
    """Displacement of the background at places [n, 2], by the steps [n, 2] of its `rows` intp [m]."""
    design, ridge = _terms(start, rows)
    own, target = design[rows], step[rows]
    square = ((target - np.median(target, axis=0)) ** 2).sum(axis=1)
    coefficients = np.zeros((design.shape[1], 2))
    plain, every = np.flatnonzero(ridge != _RIDGES[2]), np.arange(len(ridge))
    for k in range(_ROUNDS):
        typical = max(float(np.median(square)) / _CHI2_MEDIAN_2D, _LEAST_TYPICAL)
        weighted = own.T * (1 + square / (4 * typical)) ** -2
        used = plain if k < _PLAIN_ROUNDS else every
        left = weighted[used] @ own[:, used] + np.diag(ridge[used])
        coefficients[used] = np.linalg.solve(left, weighted[used] @ target)
        square = ((target - own @ coefficients) ** 2).sum(axis=1)
    return np.asarray(design @ coefficients)


def _terms(place: Floats, rows: Ints) -> tuple[Floats, Floats]:
    """Terms of a field at places [n, 2], float64 [n, T], and the ridge of each: quadratic, then the bumps."""
    low, high = place[rows].min(axis=0), place[rows].max(axis=0)
    # Beyond the background the field goes on for a tenth of its extent.
    x, y = np.clip(2 * (place - low) / np.maximum(high - low, 1.0) - 1, -1.2, 1.2).T
    columns, lines = (grid.ravel() for grid in np.meshgrid(*(np.linspace(-1, 1, count) for count in _GRID)))
    width, height = (2 / (count - 1) for count in _GRID)
    distance = ((x[:, None] - columns) / width) ** 2 + ((y[:, None] - lines) / height) ** 2
    design = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y, np.exp(-0.5 * distance)])
    return design, np.repeat([0.0, *_RIDGES], [1, 2, 3, len(columns)])


def _squares(start: Floats, residual: Floats, rows: Ints, noise: float) -> tuple[Floats, Floats]:
    """Squares of residuals [n, 2] along the lines through the epipole of `rows`, and across them, [n] each.

    The epipole is the point that the residuals point to or from, by reweighted least squares.
    """
    centre = start[rows].mean(axis=0)
    place = (start - centre) / max(float(np.sqrt(((start[rows] - centre) ** 2).sum(axis=1).mean())), 1.0)
    length = np.linalg.norm(residual, axis=1) + 1e-12
    strength = np.minimum(length / np.sqrt(max(noise, _LEAST_TYPICAL)), _CLEAR) / length
    normal = residual[:, ::-1] * [-1.0, 1.0]
    equations = (np.column_stack([normal, -(normal * place).sum(axis=1)]) * strength[:, None])[rows]
    weight, across = np.ones(len(rows)), length**2
    for _ in range(_EPIPOLE_ROUNDS):
        epipole = np.linalg.eigh((equations.T * weight) @ equations)[1][:, 0]
        toward = epipole[:2] - place * epipole[2]
        toward /= np.linalg.norm(toward, axis=1, keepdims=True) + 1e-12
        across = (normal * toward).sum(axis=1) ** 2
        typical = max(float(np.median(across[rows])) / _CHI2_MEDIAN, _LEAST_TYPICAL / 2)
        weight = (1 + across[rows] / (4 * typical)) ** -2
    return np.maximum(length**2 - across, 0.0), across
