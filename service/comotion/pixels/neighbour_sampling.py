"""Key frames in; distances between trajectories, and random groups of near ones for local motions, out."""

import numpy as np

from ..arrays import Floats32, Ints
from .kernels.neighbours import centred_terms, combine_distances, pick_members, within_limits
from .key_frames import KeyFrames

# Members are drawn from a quarter of the trajectories at most: the nearest of a few trajectories are of
# every body, and one affine motion fits two bodies. On the first 10 frames of Hopkins155 that lowered the
# error from 4.8 to 3.9 %.
_NEIGHBOURHOOD_DIVISOR = 4
# Trajectories that each local motion is fitted to, and numbers of nearest ones that they are drawn from.
# Each of these serves an even share of the local motions.
_MEMBERS, _REACHES = 8, (16, 32)
# px of distance in the image that a px of difference in displacement counts for.
MOTION_WEIGHT = 10.0
# Seeds whose distances fit the cache, and memory that has just been freed.
_SEEDS_PER_BLOCK = 64


def sample_members(frames: KeyFrames, local_motions: int, rng: np.random.Generator) -> list[Ints]:
    """Members of local motions: seeds with random picks of their nearest.

    Parameters
    ----------
    frames
        N trajectories.
    local_motions
        How many groups are drawn.
    rng
        Source of the picks.

    Returns
    -------
    list of intp [H_r, 8]
        One per reach; fewer columns where there are fewer trajectories.
    """
    total = frames.visible.shape[1]
    share = -(-local_motions // len(_REACHES))
    rounds = -(-share // total)
    # Every reach has the same seeds: the distances are what takes the time.
    seeds = np.concatenate([rng.permutation(total) for _ in range(rounds)])[:share]
    furthest = [min(reach, max(total // _NEIGHBOURHOOD_DIVISOR, _MEMBERS), total - 1) for reach in _REACHES]
    lots = [rng.random((share, last + 1)) for last in furthest]
    neighbours = NeighbourDistance(frames, MOTION_WEIGHT)
    picks = [np.empty((share, min(_MEMBERS, last + 1)), np.intp) for last in furthest]
    for start in range(0, share, _SEEDS_PER_BLOCK):
        block = slice(start, start + _SEEDS_PER_BLOCK)
        distance = neighbours.to_all(seeds[block])
        distance[np.arange(len(distance)), seeds[block]] = -1
        limits = np.partition(distance, max(furthest), axis=1)[:, max(furthest)]
        near = within_limits(distance, limits, max(furthest) + 1)
        for lot, pick in zip(lots, picks, strict=True):
            pick_members(distance, near, seeds[block], lot[block], pick[block])
    return picks


class NeighbourDistance:
    """Distance of trajectories in place and motion.

    Root mean square distance in the image plus `motion_weight` times that of the displacements
    between key frames, over the root of the share of frames that both are seen in.

    Parameters
    ----------
    frames
        Key frames of N trajectories.
    motion_weight
        Weight of displacements, 0 or more.
    """

    def __init__(self, frames: KeyFrames, motion_weight: float) -> None:
        seen = frames.visible.astype(np.float32)
        self._weight = np.float32(motion_weight)
        self._place = centred_terms(frames.positions, seen)
        self._motion = centred_terms(frames.positions[1:] - frames.positions[:-1], seen[1:] * seen[:-1])

    def to_all(self, seeds: Ints) -> Floats32:
        """Distances of all from seeds (intp [H]), float32 [H, N] px; inf without two common frames."""
        distance, both = _square(self._place, seeds)
        motion, moving = _square(self._motion, seeds)
        frames = np.float32(self._place.shape[1])
        combine_distances(distance, both, motion, moving, self._weight, frames)
        return distance


def _square(terms: Floats32, seeds: Ints) -> tuple[Floats32, Floats32]:
    """Sums of squared differences over common frames, and the number of these, [H, N]."""
    x, y, seen, square = terms[:, :, seeds]
    # |a - b|² = |a|² + |b|² - 2 ab, all in one product.
    own = np.concatenate([-2 * x, -2 * y, square, seen])
    return own.T @ terms.reshape(len(own), -1), seen.T @ terms[2]
