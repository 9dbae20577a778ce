"""Which trajectories a local motion is fitted to (METHOD-pixels step 2)."""

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .continuity import smallest
from .keyframes import Floats32, KeyFrames

Indices = NDArray[np.intp]
Floats = NDArray[np.float64]

# Among few trajectories the "nearest" are of every body, and one affine motion fits two bodies.
_SHARE = 4
# Seeds of which the distances fit the cache, and memory that has just been freed.
_BLOCK = 64


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
        See :class:`Neighbours`.
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
    furthest = [min(reach, max(total // _SHARE, members), total - 1) for reach in reaches]
    lots = [rng.random((share, last + 1)) for last in furthest]
    neighbours = Neighbours(frames, motion_weight)
    picks = [np.empty((share, min(members, last + 1)), np.intp) for last in furthest]
    for start in range(0, share, _BLOCK):
        block = slice(start, start + _BLOCK)
        distance = neighbours.distance(seeds[block])
        distance[np.arange(len(distance)), seeds[block]] = -1
        limits = np.partition(distance, max(furthest), axis=1)[:, max(furthest)]
        near = _nearest(distance, limits, max(furthest))
        for lot, pick in zip(lots, picks, strict=True):
            _pick(distance, near, seeds[block], lot[block], pick[block])
    return picks


@compiled()
def _nearest(distance: Floats32, limits: Floats32, last: int) -> Indices:
    """Indices of those up to a distance, the `last` + 1 nearest, ascending, [H, last + 1]."""
    near = np.empty((len(distance), last + 1), np.intp)
    for h in range(len(distance)):
        limit, ties, count = limits[h], last + 1, 0
        for j in range(distance.shape[1]):
            ties -= distance[h, j] < limit
        for j in range(distance.shape[1]):
            if distance[h, j] <= limit and (distance[h, j] < limit or ties > 0):
                ties -= distance[h, j] == limit
                near[h, count] = j
                count += 1
    return near


@compiled()
def _pick(distance: Floats32, near: Indices, seeds: Indices, lot: Floats, picks: Indices) -> None:
    """Of the nearest, as many as there are lots, the seed and those that draw the smallest."""
    for h in range(len(seeds)):
        # Ascending, so that the picks do not depend on who is a little nearer.
        among = near[h][np.sort(smallest(distance[h][near[h]], lot.shape[1]))]
        lot[h][among == seeds[h]] = -1
        picks[h] = among[smallest(lot[h], picks.shape[1])]


class Neighbours:
    """How far trajectories are from one another.

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
        self._place = _expand(frames.positions, seen)
        self._motion = _expand(frames.positions[1:] - frames.positions[:-1], seen[1:] * seen[:-1])

    def distance(self, seeds: Indices) -> Floats32:
        """Distances of all from seeds (intp [H]), float32 [H, N]; inf without two common frames."""
        distance, both = _square(self._place, seeds)
        motion, moving = _square(self._motion, seeds)
        frames = np.float32(self._place.shape[1])
        _combine(distance, both, motion, moving, self._weight, frames)
        return distance


def _square(terms: Floats32, seeds: Indices) -> tuple[Floats32, Floats32]:
    """Sums of squared differences over common frames, and the number of these, [H, N]."""
    x, y, seen, square = terms[:, :, seeds]
    # |a - b|² = |a|² + |b|² - 2 ab, all in one product.
    mine = np.concatenate([-2 * x, -2 * y, square, seen])
    return mine.T @ terms.reshape(len(mine), -1), seen.T @ terms[2]


@compiled()
def _expand(values: Floats32, seen: Floats32) -> Floats32:
    """x, y, whether seen and x² + y², of the frame's mean and 0 where unseen, float32 [4, F, N]."""
    terms = np.empty((4, *seen.shape), np.float32)
    for f in range(len(values)):
        cx = cy = count = 0.0
        for j in range(values.shape[1]):
            cx += values[f, j, 0] * seen[f, j]
            cy += values[f, j, 1] * seen[f, j]
            count += seen[f, j]
        # Shifting by the frame's mean keeps the difference of large squares accurate in float32.
        mx, my = np.float32(cx / max(count, 1.0)), np.float32(cy / max(count, 1.0))
        for j in range(values.shape[1]):
            x, y = (values[f, j, 0] - mx) * seen[f, j], (values[f, j, 1] - my) * seen[f, j]
            terms[0, f, j], terms[1, f, j], terms[2, f, j], terms[3, f, j] = x, y, seen[f, j], x * x + y * y
    return terms


@compiled()
def _combine(
    place: Floats32,
    both: Floats32,
    motion: Floats32,
    moving: Floats32,
    weight: np.float32,
    frames: np.float32,
) -> None:
    """Distances in place of the sums of squared differences in the image."""
    one, zero = np.float32(1), np.float32(0)
    for h in range(place.shape[0]):
        for j in range(place.shape[1]):
            apart = np.sqrt(max(place[h, j], zero) / max(both[h, j], one))
            apart += weight * np.sqrt(max(motion[h, j], zero) / max(moving[h, j], one))
            apart /= np.sqrt(max(both[h, j], one) / frames)
            place[h, j] = apart if both[h, j] >= 2 else np.float32(np.inf)
