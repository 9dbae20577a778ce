"""Measures how far apart trajectories are, and draws groups of near ones to fit local motions to."""

import numpy as np

from ..arrays import Floats32, Ints
from .key_frames import KeyFrames

# px of distance in the image that a px of difference in displacement counts for.
_MOTION_WEIGHT = np.float32(10)
# Members are drawn from a quarter of the trajectories at most: the nearest of a few trajectories are of
# every body, and one affine motion fits two bodies. On the first 10 frames of Hopkins155 that lowered the
# error from 4.8 to 3.9 %.
_NEIGHBOURHOOD_DIVISOR = 4
# Trajectories that each local motion is fitted to, numbers of nearest ones that they are drawn from, and how
# many motions are fitted for each of these numbers.
_MEMBERS, _REACHES, _LOCAL_MOTIONS = 8, (16, 32), 300


def distances(frames: KeyFrames) -> tuple[Floats32, Floats32]:
    """How far apart all pairs of N trajectories are in the image, and in place and motion, px [N, N] each.

    The former is the root mean square over key frames; the latter that, plus ten times that of displacements,
    over the root of the share of frames that both are seen in. They are inf without two common frames.
    """
    seen = frames.visible.astype(np.float32)
    image, common = _root_mean_square(frames.positions, seen)
    moved = frames.positions[1:] - frames.positions[:-1]
    local, _ = _root_mean_square(moved, seen[1:] * seen[:-1])
    local = _MOTION_WEIGHT * local + image
    local /= np.sqrt(np.maximum(common, 1) / np.float32(len(seen)))
    image[common < 2] = local[common < 2] = np.inf
    return image, local


def _root_mean_square(values: Floats32, seen: Floats32) -> tuple[Floats32, Floats32]:
    """Of the differences of values [F, N, 2] over common frames, and the number of these, [N, N]."""
    weight = seen[..., None]
    # Shifting by the frame's mean keeps the difference of large squares accurate in float32.
    mean = (values * weight).sum(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1)
    x, y = np.moveaxis((values - mean) * weight, 2, 0)
    square = x * x + y * y
    # |a - b|² = |a|² + |b|² - 2 ab, all in one product.
    total = np.concatenate([-2 * x, -2 * y, square, seen]).T @ np.concatenate([x, y, seen, square])
    common = seen.T @ seen
    return np.sqrt(np.maximum(total, 0) / np.maximum(common, 1)), common


def sample_members(local: Floats32, rng: np.random.Generator) -> Ints:
    """Members of local motions: seeds with random picks of their nearest.

    Parameters
    ----------
    local
        float32 [N, N]; distances in place and motion.
    rng
        Source of the picks.

    Returns
    -------
    intp [H, 8]
        Fewer columns where there are fewer trajectories.
    """
    total = len(local)
    seeds = np.resize(rng.permutation(total), _LOCAL_MOTIONS)
    distance, draws = local[seeds], []
    for reach in _REACHES:
        furthest = min(reach, max(total // _NEIGHBOURHOOD_DIVISOR, _MEMBERS), total - 1)
        # Ascending, so that the picks do not depend on small differences of distance.
        near = np.sort(np.argpartition(distance, furthest, axis=1)[:, : furthest + 1], axis=1)
        lots = rng.random(near.shape)
        lots[near == seeds[:, None]] = -1
        picked = np.argsort(lots, axis=1)[:, :_MEMBERS]
        draws.append(np.take_along_axis(near, picked, axis=1))
    return np.concatenate(draws)
