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


class Merging:
    """Merges superclusters.

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

    def __init__(
        self,
        similarity: Floats32,
        distance: Floats32,
        superclusters: Ints,
        consensus: Floats,
        two_bodies: Callable[[Ints, Ints], bool],
    ) -> None:
        self._similarity, self._distance = similarity, distance
        self._two_bodies = two_bodies
        self._superclusters = superclusters
        one_hot = np.eye(len(consensus))[superclusters]
        self._size = one_hot.sum(axis=0)
        self._similarities = one_hot.T @ similarity @ one_hot
        self._consensus = consensus * np.outer(self._size, self._size)
        self._group = np.arange(len(consensus))
        # By two groups and their numbers of members: groups only grow.
        self._decided: dict[tuple[int, int, int, int], bool] = {}

    def groups(self) -> Ints:
        """Group of every supercluster, intp [P], as the index of a supercluster in it."""
        while self._merge_next():
            pass
        return self._group

    def _merge_next(self) -> bool:
        """Merge the pair that is of one body and has most consensus, similarity beside it, if any."""
        groups = np.unique(self._group)
        first, second = np.triu_indices(len(groups), 1)
        consensus = self._mean(self._consensus, groups)
        order = consensus + _SIMILARITY_IN_ORDER * np.log(self._mean(self._similarities, groups))
        for k in np.argsort(-order[first, second], kind="stable").tolist():
            i, j = first[k], second[k]
            if self._merges(int(groups[i]), int(groups[j]), float(consensus[i, j])):
                self._group[self._group == groups[j]] = groups[i]
                return True
        return False

    def _mean(self, sums: Floats, groups: Ints) -> Floats:
        """Means [K, K] over the pairs of members of two groups, of sums over those of superclusters."""
        part_of = (self._group[:, None] == groups).astype(np.float64)
        size = self._size @ part_of
        return np.asarray(part_of.T @ sums @ part_of / np.outer(size, size))

    def _merges(self, a: int, b: int, consensus: float) -> bool:
        of_member = self._group[self._superclusters]
        small, large = sorted((np.flatnonzero(of_member == group) for group in (a, b)), key=len)
        if len(small) < SMALLEST:
            return True
        key = a, b, len(small), len(large)
        if key not in self._decided:
            evidence = _CONSENSUS_WEIGHT * consensus + self._contrast(small, large)
            is_one = evidence >= _LEAST_EVIDENCE
            self._decided[key] = bool(is_one) and not self._two_bodies(small, large)
        return self._decided[key]

    def _contrast(self, small: Ints, large: Ints) -> float:
        """How similarity changes across the boundary of two groups, nat; -inf if never seen together.

        The image motion of one rigid body varies from place to place as depth does, but trajectories that
        lie side by side on it are still similar. Where two bodies meet, they are not. So it is the mean log
        similarity of the smaller group's members to their nearest in the other one, less that to their
        nearest in their own; the farther the former are, the less a drop says: log of 1 + the median px.
        """
        picked = small[evenly_spaced(len(small), _COMPARED)]
        across, distance = self._to_nearest(picked, large)
        within, _ = self._to_nearest(picked, small)
        seen = (across > 0) & (within > 0)
        if not seen.any():
            return -np.inf
        return float(np.log(across[seen] / within[seen]).mean() + np.log1p(median(distance[seen])))

    def _to_nearest(self, picked: Ints, others: Ints) -> tuple[Floats, Floats]:
        """Mean similarity of the picked to their nearest others, and distance to these in px; 0 of none."""
        distance = np.where(picked[:, None] == others, np.inf, self._distance[np.ix_(picked, others)])
        nearest = np.argpartition(distance, min(_NEAREST, len(others)) - 1, axis=1)[:, :_NEAREST]
        distance = np.take_along_axis(distance, nearest, axis=1)
        seen = np.isfinite(distance)
        weight = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
        similarity = self._similarity[picked[:, None], others[nearest]]
        return (weight * similarity).sum(axis=1), (weight * np.where(seen, distance, 0)).sum(axis=1)
