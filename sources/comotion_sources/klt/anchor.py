"""Where a feature's birth patch is now: what keeps a feature on the spot that it was born on.

Following a feature from frame to frame adds up small errors, and lets it slide along an edge or go
with an outline that passes. So each frame the patch that it was born with is aligned with the image
by an affine warp and a change of brightness (Shi and Tomasi 1994; inverse compositional: Baker and
Matthews 2004), starting from where Lucas-Kanade says (the template update problem: Matthews, Ishikawa
and Baker 2004). What no longer looks like its birth patch is told by the correlation.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from ..cameras.types import Image
from .flow import Pixels

Floats = NDArray[np.float32]

_ITERATIONS = 3
# Shape may change by this share of the texture's own certainty and no more: flat patches leave it open.
_STIFFNESS = 0.02
_TINY = 1e-6
# Most that the shape may change in one step, and the darkest that a patch may have become.
_TURN = 0.3
_DARKEST = 0.1
_COLUMNS = ("patch", "power", "solve", "spread", "shape")


@dataclass(frozen=True, slots=True)
class Anchors:
    """Birth patches of N features, P pixels each.

    Attributes
    ----------
    patch
        float32 [N, P], less mean and slope.
    power
        float32 [N], sum of its squares.
    solve
        float32 [N, 6, P], from a difference of patches to the affine warp's four shape and two shift
        parameters.
    spread
        float32 [N], px² in the direction that the texture fixes least, for grey values of variance 1.
    shape
        float32 [N, 2, 2], linear part of the warp from birth to now.
    """

    patch: Floats
    power: Floats
    solve: Floats
    spread: Floats
    shape: Floats

    def __len__(self) -> int:
        return len(self.patch)

    def __getitem__(self, keep: NDArray[np.bool_]) -> "Anchors":
        if keep.all():
            return self
        return Anchors(*(getattr(self, name)[keep] for name in _COLUMNS))


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where birth patches were found.

    Attributes
    ----------
    pixels
        float32 [N, 2].
    shape
        float32 [N, 2, 2].
    correlation
        float32 [N], of the birth patch with what is there, -1 to 1.
    noise
        float32 [N], one-sigma noise of `pixels` that the remaining difference speaks of, px.
    """

    pixels: Pixels
    shape: Floats
    correlation: Floats
    noise: Floats


@cache
def _offsets(window: int) -> Floats:
    """Pixels of a window about its middle, float32 [P, 2]."""
    half = window // 2
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    return np.stack([x.ravel(), y.ravel()], 1).astype(np.float32)


@cache
def _ramps(window: int) -> Floats:
    """Orthonormal 1, x and y over a window, float32 [3, P]."""
    x = _offsets(window)
    ramps = np.stack([np.ones(len(x), np.float32), x[:, 0], x[:, 1]])
    return np.asarray(ramps / np.linalg.norm(ramps, axis=1, keepdims=True), np.float32)


def _levelled(values: Floats, window: int) -> Floats:
    """Patches [..., P] less their mean and slope."""
    ramps = _ramps(window)
    return np.asarray(values - (values @ ramps.T) @ ramps, np.float32)


def no_anchors() -> Anchors:
    """Anchors of no features."""
    sizes = ((0, 1), (0,), (0, 6, 1), (0,), (0, 2, 2))
    return Anchors(*(np.empty(size, np.float32) for size in sizes))


def joined(first: Anchors, second: Anchors) -> Anchors:
    """Anchors of both."""
    if not len(first) or not len(second):
        return first if len(first) else second
    return Anchors(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in _COLUMNS))


def take(grey: Image, pixels: Pixels, window: int) -> Anchors:
    """Anchor features [N, 2] to the patches of `window` px (or the next odd number) that are there now."""
    if not len(pixels):
        return no_anchors()
    window |= 1
    upright = np.tile(np.eye(2, dtype=np.float32), (len(pixels), 1, 1))
    wide = _sampled(grey.astype(np.float32), pixels, upright, _offsets(window + 2))
    patch, steepest = _slopes(wide.reshape(-1, window + 2, window + 2), window)
    power = np.einsum("np,np->n", patch, patch) + _TINY
    # Brightness a T + b + c.x is free (soft shadows): what it explains moves nothing.
    share = (steepest @ patch[:, :, None]) / power[:, None, None]
    steepest -= share * patch[:, None]
    normal = steepest @ steepest.transpose(0, 2, 1)
    stiff = _STIFFNESS * np.trace(normal[:, :4, :4], axis1=1, axis2=2) / 4
    normal += stiff[:, None, None] * np.diag([1.0, 1, 1, 1, 0, 0]) + _TINY * np.eye(6)
    inverse = np.linalg.inv(normal).astype(np.float32)
    spread = np.maximum(np.linalg.eigvalsh(inverse[:, 4:, 4:])[:, 1], 0)
    return Anchors(patch, power, inverse @ steepest, spread, upright)


def _slopes(wide: Floats, window: int) -> tuple[Floats, Floats]:
    """Patches [N, P] and their change by the six parameters [N, 6, P], both levelled, from wider patches."""
    x, y = _offsets(window).T
    dx = ((wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]) / 2).reshape(len(wide), -1)
    dy = ((wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]) / 2).reshape(len(wide), -1)
    steepest = np.stack([dx * x, dx * y, dy * x, dy * y, dx, dy], 1)
    return _levelled(wide[:, 1:-1, 1:-1].reshape(len(wide), -1), window), _levelled(steepest, window)


def align(grey: Image, pixels: Pixels, anchors: Anchors, window: int) -> Alignment:
    """Align birth patches with an image.

    Parameters
    ----------
    grey
        uint8 [H, W].
    pixels
        float32 [N, 2], where the features are thought to be.
    anchors
        Of the same features, shaped as in the frame before.
    window
        As in :func:`take`.
    """
    window |= 1
    x, image = _offsets(window), grey.astype(np.float32)
    centre, shape = pixels, anchors.shape
    for iteration in range(_ITERATIONS + 1):
        seen = _levelled(_sampled(image, centre, shape, x), window)
        gain = np.einsum("np,np->n", seen, anchors.patch) / anchors.power
        residual = seen - gain[:, None] * anchors.patch
        dimmed = np.maximum(gain, _DARKEST)
        if iteration < _ITERATIONS:
            step = (anchors.solve @ residual[:, :, None])[:, :, 0] / dimmed[:, None]
            turn = np.eye(2, dtype=np.float32) + np.clip(step[:, :4], -_TURN, _TURN).reshape(-1, 2, 2)
            shape = shape @ np.linalg.inv(turn)  # W <- W o dW^-1
            centre = centre - np.einsum("nij,nj->ni", shape, step[:, 4:])
    square = np.einsum("np,np->n", residual, residual)
    correlation = gain * np.sqrt(anchors.power / np.maximum(np.einsum("np,np->n", seen, seen), _TINY))
    variance = square / residual.shape[1] / dimmed**2 * anchors.spread
    return Alignment(centre, shape, correlation, np.sqrt(variance))


def _sampled(image: Floats, centre: Pixels, shape: Floats, offsets: Floats) -> Floats:
    """Grey values float32 [N, P] at centre + shape offset."""
    x, y = (shape @ offsets.T + centre[:, :, None]).transpose(1, 0, 2).astype(np.float32)
    found = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32)
