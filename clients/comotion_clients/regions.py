"""Dense regions from sparse labels: a mask per hypothesis.

Ochs and Brox (2011) make regions of sparse trajectories by a variational method. Here the random walker of
scikit-image (Grady 2006) does: each pixel gets the label of the feature that a random walk, which avoids
edges of the image, reaches first. Needs the extra `dense`.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

_EDGE_PX = 200
"""Longer edge of the image that the walk is on: seconds at full size, some ten milliseconds at this one."""
_SEED_PX = 1
# The solver's tolerance; the probabilities that it gives are rounded by as much.
_TOLERANCE, _ROUNDING = 1e-3, 0.1
NOBODY = -1


def regions(
    image: NDArray[np.uint8], pixels: NDArray[np.float32], labels: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Label every pixel of an image.

    Parameters
    ----------
    image
        uint8 [H, W, 3] or [H, W].
    pixels
        float32 [N, 2], features.
    labels
        int64 [N], their hypotheses; negative for none, which are left out.

    Returns
    -------
    int64 [H, W]; :data:`NOBODY` everywhere without labelled features.

    Raises
    ------
    ImportError
        If scikit-image is not installed.
    """
    from skimage.segmentation import random_walker

    height, width = image.shape[:2]
    known = labels >= 0
    names, index = np.unique(labels[known], return_inverse=True)
    if len(names) < 2:
        return np.full((height, width), names[0] if len(names) else NOBODY, np.int64)
    scale = min(_EDGE_PX / max(height, width), 1.0)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    seeds = _seeds(small.shape[:2], pixels[known] * scale, index)
    if len(np.unique(seeds[seeds > 0])) < len(names):
        names = names[np.unique(seeds[seeds > 0]) - 1]
        _, inverse = np.unique(seeds, return_inverse=True)
        seeds = np.asarray(inverse.reshape(seeds.shape), np.int32)
    axis = -1 if small.ndim == 3 else None
    walked = random_walker(small, seeds, mode="cg_j", tol=_TOLERANCE, prob_tol=_ROUNDING, channel_axis=axis)
    labelled = names[walked - 1].astype(np.int32)
    full = cv2.resize(labelled, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.asarray(full, np.int64)


def _seeds(shape: tuple[int, ...], pixels: NDArray[np.float32], index: NDArray[np.intp]) -> NDArray[np.int32]:
    """Small squares around features, numbered from 1; 0 elsewhere."""
    seeds = np.zeros(shape, np.int32)
    for (x, y), label in zip(np.rint(pixels).astype(int).tolist(), index.tolist(), strict=True):
        rows, columns = (slice(max(v - _SEED_PX, 0), max(v + _SEED_PX + 1, 0)) for v in (y, x))
        seeds[rows, columns] = label + 1
    return seeds


def nearest(
    shape: tuple[int, int], pixels: NDArray[np.float32], labels: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Give every pixel the label of the nearest labelled feature; as :func:`regions`."""
    known = labels >= 0
    if not known.any():
        return np.full(shape, NOBODY, np.int64)
    rows, columns = np.indices(shape)
    _, at = cKDTree(pixels[known]).query(np.column_stack([columns.ravel(), rows.ravel()]))
    return np.asarray(labels[known][at].reshape(shape), np.int64)


def intersection_over_union(found: NDArray[np.int64], true: NDArray[np.int32]) -> dict[int, float]:
    """IoU of each true object with its region; pixels of no object are left out.

    Objects and regions are matched one to one, so that the sum of IoU is largest; an object without a region
    has 0.

    Parameters
    ----------
    found, true
        int64 and int32 [H, W], hypotheses, and objects with -1 for ambiguous.
    """
    scored = true >= 0
    objects, row = np.unique(true[scored], return_inverse=True)
    names, column = np.unique(found[scored], return_inverse=True)
    both = np.bincount(row * len(names) + column, minlength=len(objects) * len(names))
    both = both.reshape(len(objects), len(names)).astype(np.float64)
    ratio = both / (both.sum(1)[:, None] + both.sum(0) - both)
    matched = dict(zip(*(side.tolist() for side in linear_sum_assignment(ratio, maximize=True)), strict=True))
    return {
        number: float(ratio[k, matched[k]]) if k in matched else 0.0
        for k, number in enumerate(objects.tolist())
    }
