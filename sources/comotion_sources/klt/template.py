"""Aligns features with what they looked like at first, so that small errors do not add up.

Tracking from frame to frame accumulates small errors, and a feature may slide along an edge or follow a
passing outline. Therefore each frame the template of a feature, its image patch at birth, is aligned
with the image by an affine warp and a change of brightness (Shi and Tomasi 1994; inverse
compositional: Baker and Matthews 2004), starting at the result of Lucas-Kanade (Matthews, Ishikawa and
Baker 2004, "The template update problem"). The correlation shows whether the image still matches.
"""

from dataclasses import dataclass
from functools import cache
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ..cameras.types import Image

Floats = NDArray[np.float32]
Pixels = NDArray[np.float32]

_ITERATIONS = 3
_EPSILON = 1e-6  # keeps the divisions and the inverse finite on a patch without texture
_MOST_STRETCHED = 3.0  # a surface that turns away by 70 degrees is seen a third as wide
_MIN_GAIN = 0.1  # smallest contrast relative to the template that still scales a step


class Columns:
    """A dataclass of columns with a row per feature: arrays, or other columns."""

    def __getitem__(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> Self:
        return type(self)(**{name: column[keep] for name, column in vars(self).items()})

    def __add__(self, new: Self) -> Self:
        pairs = {name: (column, getattr(new, name)) for name, column in vars(self).items()}
        return type(self)(
            **{n: a + b if isinstance(a, Columns) else np.concatenate([a, b]) for n, (a, b) in pairs.items()}
        )


@dataclass
class Templates(Columns):
    """Templates (patches at birth) of N features, P pixels each."""

    patch: Floats  # float32 [N, P], grey values without their mean and slope
    power: Floats  # float32 [N], sum of the squares of `patch`
    # float32 [N, 6, P], maps a difference of patches to four shape and two shift parameters of the affine
    # warp.
    gradient_inverse: Floats
    # float32 [N], px²: variance of the position in its least certain direction, for grey values of variance
    # 1.
    variance_scale: Floats
    shape: Floats  # float32 [N, 2, 2], linear part of the warp from the template to the newest image


@cache
def _offsets(window: int) -> Floats:
    """Coordinates of the pixels of a window relative to its centre, float32 [P, 2]."""
    half = window // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    return np.stack([x.ravel(), y.ravel()], 1).astype(np.float32)


@cache
def _ramps(window: int) -> Floats:
    """Orthonormal basis of the linear functions over a window, float32 [3, P]."""
    x = _offsets(window)
    ramps = np.stack([np.ones(len(x), np.float32), x[:, 0], x[:, 1]])
    return np.asarray(ramps / np.linalg.norm(ramps, axis=1, keepdims=True), np.float32)


def _detrended(values: Floats, window: int) -> Floats:
    """Subtract mean and slope from patches [..., P]."""
    ramps = _ramps(window)
    return np.asarray(values - (values @ ramps.T) @ ramps, np.float32)


def extract(grey: Image, pixels: Pixels, window: int) -> Templates:
    """Extract the templates of features from an image.

    `grey` is uint8 [H, W], `pixels` are positions float32 [N, 2], `window` is the edge of a template in px;
    an even number is raised by one.
    """
    window |= 1
    upright = np.tile(np.eye(2, dtype=np.float32), (len(pixels), 1, 1))
    wide = _sampled(grey.astype(np.float32), pixels, upright, _offsets(window + 2))
    patch, steepest = _slopes(wide.reshape(-1, window + 2, window + 2), window)
    power = np.einsum("np,np->n", patch, patch) + _EPSILON
    # Brightness may change by a T + b + c.x (soft shadows): project this out of the gradients.
    share = (steepest @ patch[:, :, None]) / power[:, None, None]
    steepest -= share * patch[:, None]
    normal = steepest @ steepest.transpose(0, 2, 1)
    inverse = np.linalg.inv(normal + _EPSILON * np.eye(6)).astype(np.float32)
    variance_scale = np.maximum(np.linalg.eigvalsh(inverse[:, 4:, 4:])[:, 1], 0)
    return Templates(patch, power, inverse @ steepest, variance_scale, upright)


def _slopes(wide: Floats, window: int) -> tuple[Floats, Floats]:
    """Detrended patches [N, P] and their gradients by the six parameters [N, 6, P], from wider patches."""
    x, y = _offsets(window).T
    dx = ((wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]) / 2).reshape(-1, window**2)
    dy = ((wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]) / 2).reshape(-1, window**2)
    steepest = np.stack([dx * x, dx * y, dy * x, dy * y, dx, dy], 1)
    return _detrended(wide[:, 1:-1, 1:-1].reshape(-1, window**2), window), _detrended(steepest, window)


def align(
    grey: Image, pixels: Pixels, templates: Templates, window: int
) -> tuple[Pixels, Floats, NDArray[np.float32]]:
    """Align templates with an image.

    `grey` is uint8 [H, W], `pixels` are predicted positions float32 [N, 2] of the features of the
    `templates`, which have the shape of the frame before; `window` is as in :func:`extract`.

    Returns
    -------
    float32 [N, 2], aligned positions; float32 [N, 2, 2], shape as in :class:`Templates`; float32 [N],
    correlation of the template with the warped image, -1 to 1.
    """
    window |= 1
    image, centre, shape = grey.astype(np.float32), pixels, templates.shape
    for _ in range(_ITERATIONS):
        seen, gain = _compared(image, centre, shape, templates, window)
        residual = seen - gain[:, None] * templates.patch
        step = (templates.gradient_inverse @ residual[:, :, None])[:, :, 0]
        step /= np.maximum(gain, _MIN_GAIN)[:, None]
        change = np.eye(2, dtype=np.float32) + step[:, :4].reshape(-1, 2, 2)
        shape = shape @ np.linalg.inv(change)  # W <- W o dW^-1
        centre = centre - np.einsum("nij,nj->ni", shape, step[:, 4:])
    return centre, shape, _correlation(*_compared(image, centre, shape, templates, window), templates)


def likeness(grey: Image, pixels: Pixels, templates: Templates, window: int) -> Floats:
    """Correlation [N] of templates, as they were at birth, with an image at other places [N, 2], px."""
    window |= 1
    upright = np.tile(np.eye(2, dtype=np.float32), (len(pixels), 1, 1))
    return _correlation(*_compared(grey.astype(np.float32), pixels, upright, templates, window), templates)


def is_upright(shape: Floats) -> NDArray[np.bool_]:
    """Which warps [N, 2, 2] can be those of a surface that turns; others are of two bodies, at an edge."""
    # The ratio of the singular values, by their sum of squares and their product.
    most = _MOST_STRETCHED + 1 / _MOST_STRETCHED
    return np.asarray((shape**2).sum(axis=(1, 2)) < most * np.linalg.det(shape))


def _compared(
    image: Floats, centre: Pixels, shape: Floats, templates: Templates, window: int
) -> tuple[Floats, Floats]:
    """What is seen in place of templates, without mean and slope [N, P], and its contrast in theirs [N]."""
    seen = _detrended(_sampled(image, centre, shape, _offsets(window)), window)
    return seen, np.einsum("np,np->n", seen, templates.patch) / templates.power


def _correlation(seen: Floats, gain: Floats, templates: Templates) -> Floats:
    power = np.maximum(np.einsum("np,np->n", seen, seen), _EPSILON)
    return np.asarray(gain * np.sqrt(templates.power / power))


def _sampled(image: Floats, centre: Pixels, shape: Floats, offsets: Floats) -> Floats:
    """Interpolate grey values float32 [N, P] at centre + shape · offset."""
    x, y = (shape @ offsets.T + centre[:, :, None]).transpose(1, 0, 2).astype(np.float32)
    if not len(centre):
        return np.empty((0, len(offsets)), np.float32)
    values = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float32)
