"""Covariance of the noise of each trajectory (step 4): published, else estimated from its observations."""

import numpy as np
from scipy.special import digamma, polygamma

from comotion_schemas.types import symmetric

from ..arrays import Floats, Ints, Stamps, find
from ..geometry.frames import RENEWED
from ..geometry.rotation import ROUNDING
from .kernels.differences import difference_covariances
from .kernels.resampling import mean_square
from .tracks import Tracks

# Share of the scene's extent: less noise than this is below the precision of float32, in which positions
# are sent.
_LEAST_NOISE = 1e-6
# Share of the scene's extent that is taken for the noise before there is any estimate; chosen on the scenes
# of docs/research/accuracy.md.
_FIRST_GUESS = 1e-3
# Ratio of the largest to the least variance up to which noise is taken for the same in all directions: 1.5 in
# standard deviations, which costs nothing. And the least variance, as a share of the
# largest, that an estimate may have in any direction.
_ROUND, _FLATTEST = 2.25, 0.01
# Least variance of a published covariance, as a share of all: the error with which a message may have it.
_ROUNDED = 1e-5
# Where rays meet, as the inverse of the distance in extents of the scene; 0: at infinity.
_CURVATURES = (0.0, *(side * curvature for curvature in (0.1, 0.2, 0.3, 0.45, 0.65, 0.9) for side in (1, -1)))
# Degrees of freedom that the prior of a source's variances has at least.
_LEAST_PRIOR = 4.0


class NoiseEstimates:
    """Covariance of the noise of every trajectory, from its own observations.

    An estimate is renewed after a share of the time that it was made from. Turn, shift and delay of a source
    matter little.
    """

    def __init__(self, dim: int) -> None:
        # Of the last trajectories.
        self._key: Stamps = np.zeros(0, np.int64)
        self._made: Stamps = np.zeros(1, np.int64)
        self._covariance: Floats = np.zeros((1, dim, dim))
        self._count: Floats = np.zeros(1)

    def read(self, tracks: Tracks, gap_ns: Stamps) -> tuple[Floats, Floats]:
        """Covariances float64 [N, dim, dim], and how many independent differences they are worth, [N].

        No difference is taken across a gap longer than `gap_ns` int64 [N].
        """
        newest, oldest = tracks.times[tracks.stop - 1], tracks.times[tracks.start]
        at = find(tracks.key, self._key)
        made, covariance, count = self._made[at], self._covariance[at], self._count[at]
        due = np.flatnonzero((at < 0) | (made > newest) | (newest - made > RENEWED * (newest - oldest)))
        covariance[due], count[due] = difference_covariances(tracks.observations, gap_ns, due)
        made[due] = newest[due]
        self._key, self._made, self._covariance, self._count = tracks.key, made, covariance, count
        return covariance, count


def noise_covariances(tracks: Tracks, estimate: Floats, count: Floats, own: Ints, *, on_arm: bool) -> Floats:
    """Covariance of the white noise of trajectories `own`, float64 [n, 3, 3].

    The less the estimates of a source differ beyond their own error, the more each is drawn towards their
    usual value. Where that is about the same in all directions, so is the covariance. A published sigma or
    covariance replaces it; but at the end of an arm it is only a lower bound, as the orientation is noisy
    too. In 2-D the third coordinate has the mean of the others.

    Parameters
    ----------
    estimate, count
        float64 [n, dim, dim] and [n], of :meth:`NoiseEstimates.read`.
    own
        intp [n], indices of trajectories.
    on_arm
        Whether the differences are those of the ends of arms (see :mod:`comotion.rigid.resampling`).
    """
    sources, estimated = tracks.source[own], count > 0
    first = (_FIRST_GUESS * tracks.extent) ** 2
    scene = np.median(estimate[estimated], 0) if estimated.any() else first * np.eye(tracks.dim)
    covariance = np.zeros((len(own), 3, 3))
    for source in np.unique(sources).tolist():
        group = np.flatnonzero(sources == source)
        covariance[group] = _covariances(estimate[group], count[group], scene, tracks.newest[own[group]])
    published = mean_square(tracks.sigma, tracks.start[own], tracks.stop[own])
    has_sigma = np.isfinite(published)
    if on_arm:
        published = np.maximum(published, np.trace(covariance, axis1=1, axis2=2) / 3)
    covariance[has_sigma] = published[has_sigma, None, None] * np.eye(3)
    if not on_arm:
        full = np.isfinite(tracks.covariance[own, 0])
        covariance[full] = _resolved(symmetric(tracks.covariance[own[full]]), tracks.extent)
        covariance[full, 2, 2] += 0.0 if tracks.dim == 3 else np.trace(covariance[full], axis1=1, axis2=2) / 2
    return np.asarray(covariance + (_LEAST_NOISE * tracks.extent) ** 2 * np.eye(3))


def _resolved(covariance: Floats, extent: float) -> Floats:
    """Published covariances [n, 3, 3], no wider than the scene, with variance in every direction."""
    total = np.trace(covariance, axis1=1, axis2=2)[:, None, None]
    scaled = covariance * (extent**2 / np.maximum(total, extent**2))
    return np.asarray(scaled + _ROUNDED * np.minimum(total, extent**2) * np.eye(3))


def _covariances(estimate: Floats, count: Floats, scene: Floats, position: Floats) -> Floats:
    """Covariances [n, 3, 3] of the noise of one source.

    Where it is not round, a sensor with rays explains it: each feature has a variance along its ray and one
    across. Both lack the bias that the least eigenvalue of a rough matrix has.

    Parameters
    ----------
    estimate, count, scene
        float64 [n, dim, dim], [n] and [dim, dim], covariances of the source and of the scene.
    position
        float64 [n, 3].
    """
    estimated = count > 0
    pooled, dim = np.median(estimate[estimated], 0) if estimated.any() else scene, len(scene)
    size, axes = np.linalg.eigh(pooled)
    total = np.trace(estimate, axis1=1, axis2=2)
    if size[-1] <= _ROUND * size[0]:
        mean = shrunk(total / dim, dim * count, float(np.trace(scene)) / dim)
        return np.asarray(mean[:, None, None] * np.eye(3))
    ray = _rays(position[:, :dim], estimate, count, axes[:, -1])
    along = np.clip(np.einsum("ni,nij,nj->n", ray, estimate, ray), _FLATTEST * total, total)
    across = np.maximum((total - along) / (dim - 1), _FLATTEST * total)
    # A median of covariances, entry by entry, need not be one.
    least, most = float(size[:-1].mean().clip(_FLATTEST * size[-1])), float(size[-1])
    along, across = shrunk(along, count, most), shrunk(across, (dim - 1) * count, least)
    covariance = np.zeros((len(ray), 3, 3))
    covariance[:] = across[:, None, None] * np.eye(3)
    covariance[:, :dim, :dim] += (along - across)[:, None, None] * ray[:, :, None] * ray[:, None]
    return covariance


def shrunk(variance: Floats, freedom: Floats, otherwise: float) -> Floats:
    """Posterior variances [n] of estimates [n] with degrees of freedom [n] (Smyth 2004).

    Their prior, a scaled inverse chi-squared distribution, is fitted to the logarithms of all: their spread
    is the error of the estimates plus the spread of the true variances. `otherwise` is taken where there are
    no estimates.
    """
    usable = (freedom > 0) & (variance > 0)
    if not usable.any():
        return np.full(len(variance), otherwise)
    half = freedom[usable] / 2
    logs = np.log(variance[usable]) - digamma(half) + np.log(half)
    weight = 1 / polygamma(1, half)
    mean = float(weight @ logs / weight.sum())
    beyond = float(weight @ ((logs - mean) ** 2 - 1 / weight) / weight.sum())
    # The inverse of the trigamma function, within a tenth: x is about 1/y + 1/2 where it is large.
    prior = max(2 / max(beyond, ROUNDING) + 1, _LEAST_PRIOR)
    usual = float(np.exp(mean + digamma(prior / 2) - np.log(prior / 2)))
    return np.asarray((prior * usual + freedom * variance) / (prior + freedom))


def _rays(position: Floats, matrices: Floats, weight: Floats, axis: Floats) -> Floats:
    """Directions [n, dim] from the place of the sensor along which the noise is largest.

    The place is sought on the line through the features along the main axis of their noise, at either side
    and at infinity.
    """
    centre = np.median(position, 0)
    extent = np.sqrt(((position - centre) ** 2).sum(1).mean()) + 1e-300
    best, most = np.tile(axis, (len(position), 1)), -np.inf
    share = weight / np.maximum(np.trace(matrices, axis1=1, axis2=2), 1e-300)
    for curvature in _CURVATURES:
        ray = axis + curvature / extent * (position - centre)
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        total = float(share @ np.einsum("ni,nij,nj->n", ray, matrices, ray))
        if total > most:
            best, most = ray, total
    return best
