"""Which trajectories a local motion is fitted to (METHOD-pixels step 2)."""

import numpy as np
from numpy.typing import NDArray

from .keyframes import Floats32, KeyFrames

Indices = NDArray[np.intp]

# Among few trajectories the "nearest" are of every body, and one affine motion fits two bodies.
_SHARE = 4


def sample_members(
    frames: KeyFrames,
    count: int,
    members: int,
    reaches: tuple[int, ...],
    motion_weight: float,
    rng: np.random.Generator,
) -> list[Indices]:
    """Seeds with random picks of their nearest.

    Parameters
    ----------
    frames
        N trajectories.
    count
        Local motions wanted.
    members
        Trajectories per motion, its seed included.
    reaches
        Numbers of nearest trajectories to pick from; each serves an even share of the motions.
    motion_weight
        See :func:`neighbour_distance`.
    rng
        Source of the picks.

    Returns
    -------
    list of intp [H_r, members]
        One per reach; fewer columns where there are fewer trajectories.
    """
    total = frames.visible.shape[1]
    share = -(-count // len(reaches))
    rounds = -(-share // total)
    # Every reach has the same seeds: the distances are what takes the time.
    seeds = np.concatenate([rng.permutation(total) for _ in range(rounds)])[:share]
    distance = neighbour_distance(frames, seeds, motion_weight)
    return [
        _pick(distance, seeds, min(reach, max(total // _SHARE, members), total - 1), members, rng)
        for reach in reaches
    ]


def _pick(distance: Floats32, seeds: Indices, reach: int, members: int, rng: np.random.Generator) -> Indices:
    distance[np.arange(len(seeds)), seeds] = -1
    near = np.argpartition(distance, reach, axis=1)[:, : reach + 1]
    # Sorted, so that the picks do not depend on how a partition happens to order its left side.
    near = np.sort(near, axis=1)
    lot = rng.random(near.shape)
    lot[near == seeds[:, None]] = -1
    chosen = np.argsort(lot, axis=1, kind="stable")[:, :members]
    return np.take_along_axis(near, chosen, axis=1)


def neighbour_distance(frames: KeyFrames, seeds: Indices, motion_weight: float) -> Floats32:
    """How far trajectories are from seeds (intp [H]), float32 [H, N].

    Root mean square distance in the image plus `motion_weight` times that of the displacements
    between key frames, over the root of the share of frames that both are seen in.
    """
    seen = frames.visible.astype(np.float32)
    moving = seen[1:] * seen[:-1]
    both = seen[:, seeds].T @ seen
    distance = np.sqrt(_mean_square(frames.positions, seen, seeds))
    distance += np.float32(motion_weight) * np.sqrt(
        _mean_square(np.diff(frames.positions, axis=0), moving, seeds)
    )
    distance /= np.sqrt(np.maximum(both, 1) / np.float32(len(seen)))
    distance[both < 2] = np.inf
    return distance


def _mean_square(values: Floats32, seen: Floats32, seeds: Indices) -> Floats32:
    """Mean squared difference over the frames that seed and trajectory are both seen in, [H, N]."""
    centre = (values * seen[..., None]).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    # Shifting by the frame's mean keeps the difference of large squares accurate in float32.
    centred = (values - centre[:, None]) * seen[..., None]
    square = (centred**2).sum(axis=2)
    cross = centred.transpose(0, 2, 1).reshape(2 * len(seen), -1)
    total = square[:, seeds].T @ seen + seen[:, seeds].T @ square - 2 * (cross[:, seeds].T @ cross)
    result: Floats32 = np.maximum(total, 0) / np.maximum(seen[:, seeds].T @ seen, 1)
    return result
