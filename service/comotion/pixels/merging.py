"""Merges superclusters to one group per object. This decides the number of objects."""

from collections.abc import Callable

import numpy as np

from ..arrays import Floats, Floats32, Ints, median
from .key_frames import evenly_spaced

SMALLEST = 5
"""Members below which a group joins another one without evidence."""

# Members of the smaller group that are compared, each with so many of the other group and of its own.
_COMPARED, _NEAREST = 40, 5
# Evidence, in nat, that a consensus of 1 is for one body, beside the drop of log similarity across the
# boundary of two groups and log(1 + their distance in px); and what must be reached. docs/research/pixels.md
# says how these were found.
_CONSENSUS_WEIGHT, _LEAST_EVIDENCE = 8.0, 1.9
# What a nat of log similarity counts for beside consensus where the next pair is chosen.
_SIMILARITY_IN_ORDER = 0.05


def merged(
    similarity: Floats32,
    distance: Floats32,
    superclusters: Ints,
    consensus: Floats,
    two_bodies: Callable[[Ints, Ints], bool],
) -> list[Ints]:
    """Groups of trajectories, intp each, ascending: the superclusters that are of one body.

    The pair of most consensus about epipolar geometries comes first. Two groups merge if there is consensus
    and similarity does not drop across their boundary; one can make up for the other. Epipolar geometry
    over wide baselines can overrule that. Groups that are too small join whatever comes first.

    Parameters
    ----------
    similarity, distance
        float32 [N, N]; of the trajectories, above 0, and how far apart they are in the image, px.
    superclusters
        intp [N], 0 to P - 1.
    consensus
        float64 [P, P]; of the superclusters about epipolar geometries.
    two_bodies
        Whether two groups, intp each, contradict one another over wide baselines.
    """
    groups = [np.flatnonzero(superclusters == k) for k in range(len(consensus))]
    one_hot = np.eye(len(groups))[superclusters]
    size = one_hot.sum(axis=0)
    # Over the pairs of members of two groups.
    sums = np.stack([consensus * np.outer(size, size), one_hot.T @ similarity @ one_hot])
    # By the first members and numbers of members of two groups: groups only grow.
    decided: dict[tuple[int, ...], bool] = {}

    def are_one(i: int, j: int, agreed: float) -> bool:
        small, large = sorted((groups[i], groups[j]), key=len)
        if len(small) < SMALLEST:
            return True
        key = int(small[0]), len(small), int(large[0]), len(large)
        if key not in decided:
            evidence = _CONSENSUS_WEIGHT * agreed + _contrast(similarity, distance, small, large)
            decided[key] = evidence >= _LEAST_EVIDENCE and not two_bodies(small, large)
        return decided[key]

    while True:
        agreed, alike = sums / np.outer(size, size)
        order = agreed + _SIMILARITY_IN_ORDER * np.log(alike)
        pairs = np.argwhere(np.triu(np.ones(order.shape, np.bool_), 1))
        pairs = pairs[np.argsort(-order[tuple(pairs.T)], kind="stable")]
        pair = next(((i, j) for i, j in pairs.tolist() if are_one(i, j, agreed[i, j])), None)
        if pair is None:
            return groups
        i, j = pair
        groups[i] = np.sort(np.concatenate([groups[i], groups.pop(j)]))
        sums[:, i] += sums[:, j]
        sums[:, :, i] += sums[:, :, j]
        size[i] += size[j]
        sums, size = np.delete(np.delete(sums, j, 1), j, 2), np.delete(size, j)


def _contrast(similarity: Floats32, distance: Floats32, small: Ints, large: Ints) -> float:
    """How similarity changes across the boundary of two groups, nat; -inf if never seen together.

    The image motion of one rigid body varies from place to place as depth does, but trajectories that
    lie side by side on it are still similar. Where two bodies meet, they are not. So it is the mean log
    similarity of the smaller group's members to their nearest in the other one, less that to their
    nearest in their own; the farther the former are, the less a drop says: log of 1 + the median px.
    """
    picked = small[evenly_spaced(len(small), _COMPARED)]
    across, far = _to_nearest(similarity, distance, picked, large)
    within, _ = _to_nearest(similarity, distance, picked, small)
    seen = (across > 0) & (within > 0)
    if not seen.any():
        return -np.inf
    return float(np.log(across[seen] / within[seen]).mean() + np.log1p(median(far[seen])))


def _to_nearest(
    similarity: Floats32, distance: Floats32, picked: Ints, others: Ints
) -> tuple[Floats, Floats]:
    """Mean similarity of the picked to their nearest others, and distance to these in px; 0 of none."""
    far = np.where(picked[:, None] == others, np.inf, distance[np.ix_(picked, others)])
    nearest = np.argpartition(far, min(_NEAREST, len(others)) - 1, axis=1)[:, :_NEAREST]
    far = np.take_along_axis(far, nearest, axis=1)
    seen = np.isfinite(far)
    weight = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
    alike = similarity[picked[:, None], others[nearest]]
    return (weight * alike).sum(axis=1), (weight * np.where(seen, far, 0)).sum(axis=1)
