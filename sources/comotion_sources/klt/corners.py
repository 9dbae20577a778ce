"""Finds new features, spread over the image: Shi-Tomasi corners where there are none yet."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from ..cameras.types import Image
from .config import TrackerConfig
from .flow import Pixels, inside

Usable = Callable[[Pixels], NDArray[np.bool_]]
_SUBPIX = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)  # iterations, px
_SUBPIX_HALF = 3  # half the edge of the search window, px


def new_corners(grey: Image, present: Pixels, config: TrackerConfig, usable: Usable | None = None) -> Pixels:
    """Choose the best corners in empty cells as new features, up to the feature budget.

    Corners are ranked by the number of features already in their tile, then by quality. A textured
    floor therefore does not use up the budget of the other tiles.

    Parameters
    ----------
    grey
        uint8 [H, W].
    present
        float32 [N, 2], existing features.
    config
        Budget, grid and quality.
    usable
        Maps pixels [M, 2] to a mask bool [M] of those that can be used, e.g. that have depth;
        None: all.

    Returns
    -------
    float32 [M, 2], sub-pixel corners, best first within a tile.
    """
    free = config.max_features - len(present)
    free = free if config.spawn_limit is None else min(free, config.spawn_limit)
    if free <= 0:
        return np.empty((0, 2), np.float32)
    candidates = _best_per_cell(_corners(grey, config), present, grey.shape, config)
    if usable is not None and len(candidates):
        candidates = candidates[usable(candidates)]
    chosen = candidates[_balanced_order(candidates, present, grey.shape, config)[:free]]
    corners = _refined(grey, chosen, config)
    return corners[~crowded(np.concatenate([present, corners]), config.min_distance)[len(present) :]]


def _corners(grey: Image, config: TrackerConfig) -> Pixels:
    """Find all corners of the image, best first, ignoring the existing features."""
    everywhere = np.full(grey.shape, 255, np.uint8)
    corners, quality = cv2.goodFeaturesToTrackWithQuality(grey, 0, config.quality, 0.0, everywhere)
    if corners is None:
        return np.empty((0, 2), np.float32)
    corners = corners.reshape(-1, 2)[np.asarray(quality).ravel() >= config.quality_floor]
    return np.asarray(corners[inside(corners, grey.shape, config.window // 2 + 1)], np.float32)


def _grid(pixels: Pixels, columns: int, size_x: float, size_y: float) -> NDArray[np.int64]:
    x, y = pixels[:, 0] // size_x, pixels[:, 1] // size_y
    return y.astype(np.int64) * columns + x.astype(np.int64)


def _best_per_cell(corners: Pixels, present: Pixels, shape: tuple[int, ...], config: TrackerConfig) -> Pixels:
    columns = shape[1] // config.cell + 1
    cells = _grid(corners, columns, config.cell, config.cell)
    free = np.flatnonzero(~np.isin(cells, _grid(present, columns, config.cell, config.cell)))
    _, first = np.unique(cells[free], return_index=True)
    return corners[free[np.sort(first)]]


def _balanced_order(
    candidates: Pixels, present: Pixels, shape: tuple[int, ...], config: TrackerConfig
) -> NDArray[np.intp]:
    """Order candidates by their rank within the tile, counting its existing features, then by quality."""
    size_x, size_y = shape[1] / config.tiles, shape[0] / config.tiles
    held = np.bincount(_grid(present, config.tiles, size_x, size_y), minlength=config.tiles**2)
    tiles = _grid(candidates, config.tiles, size_x, size_y)
    rank = np.zeros(len(candidates), np.int64)
    for tile in np.unique(tiles):
        members = np.flatnonzero(tiles == tile)
        rank[members] = held[tile] + np.arange(len(members))
    return np.lexsort((np.arange(len(candidates)), rank))


def _refined(grey: Image, corners: Pixels, config: TrackerConfig) -> Pixels:
    """Refine corners to sub-pixel positions; keep the original where the refinement diverges."""
    if not len(corners):
        return corners
    half = (_SUBPIX_HALF, _SUBPIX_HALF)
    fine = cv2.cornerSubPix(grey, corners[:, None].copy(), half, (-1, -1), _SUBPIX).reshape(-1, 2)
    diverged = ~np.isfinite(fine).all(axis=1) | (np.abs(fine - corners).max(axis=1) > _SUBPIX_HALF)
    kept = ~diverged & inside(fine, grey.shape, config.window // 2)
    return np.where(kept[:, None], fine, corners).astype(np.float32)


def crowded(pixels: Pixels, distance: float) -> NDArray[np.bool_]:
    """Mark features that are too close to an older one.

    Parameters
    ----------
    pixels
        float32 [N, 2], oldest first.
    distance
        Least distance, px.

    Returns
    -------
    bool [N]; of each group of close features the oldest remains.
    """
    from scipy.spatial import KDTree

    removed = np.zeros(len(pixels), bool)
    if len(pixels) < 2 or distance <= 0:
        return removed
    pairs = KDTree(pixels).query_pairs(distance, output_type="ndarray")
    # From the oldest on: a feature that is itself removed removes no other.
    for older, younger in pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))]:
        if not removed[older]:
            removed[younger] = True
    return removed
