"""Merges superclusters to one group per object. This decides the number of objects."""

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


def merged(similarity: Floats32, distance: Floats32, superclusters: Ints, consensus: Floats) -> Ints:
    """Groups of trajectories, intp [N] from 0 on: the superclusters that are of one body.

    The pair of most consensus about epipolar geometries comes first. Two groups merge if there is consensus
    and similarity does not drop across their boundary; one can make up for the other. Groups that are too
    small join whatever comes first.

    Parameters
    ----------
    similarity, distance
        float32 [N, N]; of the trajectories, above 0, and how far apart they are in the image, px.
    superclusters
        intp [N], 0 to P - 1.
    consensus
        float64 [P, P]; of the superclusters about epipolar geometries.
    """
    # Group of each supercluster.
    body = np.arange(len(consensus))
    one_hot = np.eye(len(body))[superclusters]
    size = one_hot.sum(axis=0)
    # Over the pairs of members of two superclusters.
    sums = np.stack([consensus * np.outer(size, size), one_hot.T @ similarity @ one_hot])
    decided: dict[tuple[bytes, bytes], bool] = {}

    def are_one(i: int, j: int, agreed: float) -> bool:
        small, large = sorted((np.flatnonzero(body[superclusters] == k) for k in (i, j)), key=len)
        if len(small) < SMALLEST:
            return True
        key = small.tobytes(), large.tobytes()
        if key not in decided:
            evidence = _CONSENSUS_WEIGHT * agreed + _contrast(similarity, distance, small, large)
            decided[key] = evidence >= _LEAST_EVIDENCE
        return decided[key]

    while True:
        of_group = np.eye(body.max() + 1)[body]
        agreed, alike = of_group.T @ sums @ of_group / np.outer(size @ of_group, size @ of_group)
        order = agreed + _SIMILARITY_IN_ORDER * np.log(alike)
        pairs = np.argwhere(np.triu(np.ones(order.shape, np.bool_), 1))
        pairs = pairs[np.argsort(-order[tuple(pairs.T)], kind="stable")]
        pair = next(((i, j) for i, j in pairs.tolist() if are_one(i, j, agreed[i, j])), None)
        if pair is None:
            return np.asarray(body[superclusters])
        body[body == pair[1]] = pair[0]
        body[body > pair[1]] -= 1


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


def _to_nearest(similarity: Floats32, distance: Floats32, picked: Ints, others: Ints) -> Floats:
    """Mean similarity of n picked to their nearest others, and distance to these in px, [2, n]; 0 of none."""
    far = np.where(picked[:, None] == others, np.inf, distance[np.ix_(picked, others)])
    nearest = np.argpartition(far, min(_NEAREST, len(others)) - 1, axis=1)[:, :_NEAREST]
    far = np.take_along_axis(far, nearest, axis=1)
    seen = np.isfinite(far)
    both = np.stack([similarity[picked[:, None], others[nearest]], far], dtype=np.float64)
    return np.asarray(np.where(seen, both, 0).sum(axis=2) / np.maximum(seen.sum(axis=1), 1))
