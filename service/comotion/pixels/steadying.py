"""Subtracts from all motion what the background at rest would show, before a camera that moves.

The background is one rigid structure: a depth of each trajectory, and a camera at each of the past instants
(resection and intersection in turns, as in projective factorisation; Hartley and Zisserman 2004, chapter 18).
A trajectory has the same depth at any time, so that parallax of what is near is no motion, while what moves
contradicts the epipolar geometry, or the depth it had. Neither focal length nor the camera's path is known:
the structure is projective. All constants were chosen on made-up scenes of docs/research/pixels.md.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from ..arrays import Bools, Floats, Ints, Stamps, find, nanmedian
from .gains import rest_gain
from .recent import Recent

# Trajectories of the background without which its motion is unknown.
_LEAST_BACKGROUND = 12
# Rounds of fits of cameras and depths where no structure is carried on, from random depths; of reweighting in
# each.
_FIRST_ROUNDS, _REWEIGHTED = 8, 4
# px²; smallest typical squared residual that weights refer to. Ridge of a camera, per trajectory.
_LEAST_TYPICAL, _RIDGE = 0.05, 1e-5
# px²; variance of a displacement about the structure from which on the background is not rigid, and the time
# scale of it; that over which what is new in view was not seen.
_RIGID_PX2, _SCALE, _LONG = 1.0, 1, 2
# In squared depths of the background: precision of a newborn trajectory's, the most that is kept of one, and
# its share that is kept from step to step.
_NEWBORN, _MOST, _KEPT = 0.25, 400.0, 0.5
# Of a camera, up to a factor.
_PARAMETERS = 11
_CHI2_MEDIAN_2D = chdtri(2, 0.5)


class _Views(NamedTuple):
    """n trajectories now, float64 [n, 2], and at S past instants, [S, n, 2]; seen, and in use, bool [S, n].

    Places are in the extent of the background, which is in px. The variance of a displacement is [n], its
    floor that of typical squared residuals; `scales` intp [S] are those of the instants.
    """

    place: Floats
    past: Floats
    seen: Bools
    used: Bools
    variance: Floats
    floor: float
    scales: Ints
    extent: float


class Steadying:
    """Follows the depth of each trajectory of a window.

    Attributes
    ----------
    rigid
        Whether the background was one rigid structure at the last call.
    """

    def __init__(self) -> None:
        self.rigid = False
        self._keys: Stamps = np.zeros(0, np.int64)
        # Of each: inverse depth less a plane, in the root mean square of all, and its precision.
        self._depth, self._precision = np.zeros((2, 0))

    def steadied(self, recent: Recent, keys: Stamps, labels: Ints) -> Recent:
        """Displacements relative to those of the background, with its variance about them.

        Parameters
        ----------
        recent
            Of n trajectories.
        keys
            int64 [n], ascending; stable numbers of the trajectories.
        labels
            intp [n]; bodies of the trajectories, 0 for the background, -1 for none.
        """
        lost, self.rigid = not self.rigid, False
        at = find(keys, self._keys)
        depth = np.append(self._depth, 0.0)[at]
        precision = np.clip(_KEPT * np.append(self._precision, 0.0)[at], _NEWBORN, _MOST)
        # Whether what came into view lately rests is for the structure to say.
        background = (labels == 0) | ~recent.seen[_LONG]
        scales = np.flatnonzero((recent.seen & background).sum(axis=1) >= _LEAST_BACKGROUND)
        if not len(scales):
            return replace(recent, tolerance=np.full(recent.seen.shape, np.inf))
        views = _views(recent, scales, background)
        if lost:
            depth = np.random.default_rng(0).standard_normal(len(depth))
            precision = np.full(len(depth), _NEWBORN)
        rounds = _FIRST_ROUNDS if lost else 1
        depth, precision, relative, spread = _structure(recent, views, depth, precision, rounds, labels)
        self.rigid = bool((spread[scales == _SCALE] < _RIGID_PX2).any())
        self._keep(keys, views.place, depth, precision, background)
        return relative

    def _keep(self, keys: Stamps, place: Floats, depth: Floats, precision: Floats, members: Bools) -> None:
        """Depths up to a plane and a factor, which cameras make up for."""
        plane = np.column_stack([np.ones(len(place)), place])
        weight = np.where(members, precision / (1 + precision), 0.0)
        depth = depth - plane @ np.linalg.lstsq(plane * weight[:, None], depth * weight, rcond=None)[0]
        square = max(float((weight * depth**2).sum() / weight.sum()), 1e-12)
        self._keys, self._depth, self._precision = keys, depth / np.sqrt(square), precision * square


def _structure(
    recent: Recent, views: _Views, prior: Floats, precision: Floats, rounds: int, labels: Ints
) -> tuple[Floats, Floats, Recent, Floats]:
    """Depths [n] and precisions [n], with cameras in turns; motion relative to it, and its variance [S]."""
    depth, weight = prior, views.used.astype(np.float64)
    for _ in range(rounds):
        cameras, weight, typical = _cameras(views, depth, weight)
        depth, information = _depths(views, cameras, depth, prior, precision, typical)
    displacement, tolerance = recent.displacement.copy(), np.full(recent.seen.shape, np.inf)
    displacement[views.scales] = _departure(views, cameras, depth)
    square = (displacement[views.scales] ** 2).sum(axis=2)
    spread = nanmedian(np.where(views.used, square, np.nan), 1) / _CHI2_MEDIAN_2D
    noise = nanmedian(np.where(views.used, 2 * recent.variance, np.nan), 1)
    # At least what the noise of the background does to its cameras.
    least = noise * _PARAMETERS / (2 * views.used.sum(axis=1))
    tolerance[views.scales] = np.maximum(spread - noise, least)[:, None] / 2
    rests = rest_gain(replace(recent, displacement=displacement, tolerance=tolerance)) > 0
    # What moves keeps its depth, so that its motion is that of its body. What is new on that would learn one
    # that explains slow motion as rest: most of a body must rest.
    most_rest = np.bincount(labels + 1, rests - 0.5) > 0
    known = (rests & most_rest[labels + 1]) | (rounds > 1)
    depth, precision = np.where(known, depth, prior), np.where(known, information, precision)
    displacement[views.scales] = _departure(views, cameras, depth)
    return depth, precision, replace(recent, displacement=displacement, tolerance=tolerance), spread


def _departure(views: _Views, cameras: Floats, depth: Floats) -> Floats:
    """Of where trajectories were from where they are, had they rested, px [S, n, 2]."""
    return (_project(cameras, views.place, depth)[0] - views.past) * views.extent


def _views(recent: Recent, scales: Ints, members: Bools) -> _Views:
    own = recent.position[members]
    centre = own.mean(axis=0)
    extent = max(float(np.sqrt(((own - centre) ** 2).mean())), 1.0)
    place, seen = (recent.position - centre) / extent, recent.seen[scales]
    past = place - recent.displacement[scales] / extent
    variance, floor = 2 * recent.variance / extent**2, _LEAST_TYPICAL / extent**2
    return _Views(place, past, seen, seen & members, variance, floor, scales, extent)


def _cameras(views: _Views, depth: Floats, weight: Floats) -> tuple[Floats, Floats, Floats]:
    """Cameras [S, 3, 4] by depths [n], linear and reweighted; weights [S, n], typical squared residuals [S].

    What is far from the plane has less weight than its leverage: it would bend the cameras to its own motion.
    """
    scene = np.column_stack([views.place, np.ones(len(depth)), depth])
    target = views.past.mT
    rows = np.zeros((*target.shape, _PARAMETERS))
    rows[:, 0, :, :4] = rows[:, 1, :, 4:8] = scene
    rows[..., 8:] = -target[..., None] * scene[:, [0, 1, 3]]
    rows, target = rows.reshape(len(target), -1, _PARAMETERS), target.reshape(len(target), -1, 1)
    identity = np.eye(_PARAMETERS)[0] + np.eye(_PARAMETERS)[5]
    for _ in range(_REWEIGHTED):
        total = weight / (1 + depth**2)
        weighted = (rows * np.tile(total, 2)[..., None]).mT
        normal = weighted @ rows
        ridge = _RIDGE * total.sum(axis=1)[:, None, None] * np.eye(_PARAMETERS)
        change = np.linalg.solve(normal + ridge, weighted @ target - normal @ identity[:, None])[..., 0]
        cameras = np.insert(identity + change, 10, 1.0, axis=1).reshape(-1, 3, 4)
        square = ((_project(cameras, views.place, depth)[0] - views.past) ** 2).sum(axis=2)
        typical = nanmedian(np.where(views.used, square, np.nan), 1) / _CHI2_MEDIAN_2D
        scale = 4 * np.maximum(typical, views.floor)[:, None]
        weight = views.used * (1 + square / scale) ** -2
    return cameras, weight, typical


def _depths(
    views: _Views, cameras: Floats, depth: Floats, prior: Floats, precision: Floats, typical: Floats
) -> tuple[Floats, Floats]:
    """Depths [n] by cameras, a step of Gauss and Newton from some, and their precisions [n]."""
    image, slope = _project(cameras, views.place, depth)
    weight = views.seen / np.maximum(views.variance + typical[:, None] / 2, views.floor)
    information = precision + (weight * (slope**2).sum(axis=2)).sum(axis=0)
    gradient = (weight * (slope * (views.past - image)).sum(axis=2)).sum(axis=0)
    return depth + (gradient + precision * (prior - depth)) / information, information


def _project(cameras: Floats, place: Floats, depth: Floats) -> tuple[Floats, Floats]:
    """Images [S, n, 2] of places [n, 2] at depths [n], and their derivatives by these."""
    image = np.column_stack([place, np.ones(len(depth)), depth]) @ cameras.mT
    scale = np.maximum(image[..., 2:], 0.1)
    image = image[..., :2] / scale
    return image, (cameras[:, None, :2, 3] - image * cameras[:, None, 2:, 3]) / scale
