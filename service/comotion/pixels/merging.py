"""Merges superclusters to one group per object. This decides the number of objects."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Floats32, Ints, Labels
from .geometry import Geometry

# Members of the other and of the own group that a member is compared with.
_NEAREST = 5
# Members of the smaller group that are compared.
_COMPARED = 40
# Added to a mean similarity before its logarithm is taken, so that 0 stays finite.
_SIMILARITY_FLOOR = 1e-3
# Mean similarity at which superclusters merge if the smaller has so many members; the threshold grows with
# the root of its size over that.
SIMILARITY, _SIZE = 0.0075, 40
# Evidence, in nat, that a consensus of 1 is for one body, beside the drop of log similarity across the
# boundary of two groups and log(1 + their distance in px); and what must be reached. docs/research/pixels.md
# says how these were found.
_CONSENSUS_WEIGHT, _LEAST_EVIDENCE = 8.0, 1.9
# What a nat of log similarity counts for beside consensus where the next pair is chosen.
_SIMILARITY_IN_ORDER = 0.05
# Share of the trajectories below which a group dissolves.
_SMALLEST_SHARE = 0.02
# nat; evidence from what two groups were before: one hypothesis, or two.
_HELD_TOGETHER, _HELD_APART = 0.5, 0.25


def sums_over_groups(values: NDArray[np.floating[Any]], labels: Ints) -> Floats:
    """Sums of the rows of values [N, M] over each of K groups (intp [N]), float64 [K, M]."""
    return np.asarray(np.eye(labels.max() + 1)[labels].T @ values)


class Merging:
    """Merges superclusters.

    The pair of most consensus about epipolar geometries comes first. Two groups merge if there is consensus
    and similarity does not drop across their boundary; one can make up for the other. Epipolar geometry
    over wide baselines can overrule that. In the end groups that are too small dissolve.

    Parameters
    ----------
    similarity, distance
        float32 [N, N]; of the trajectories, and how far apart they are in the image, px.
    superclusters
        intp [N], 0 to P - 1.
    consensus
        float64 [P, P]; of the superclusters about epipolar geometries.
    geometry
        Compares groups over wide baselines.
    smallest
        Members below which a group dissolves.
    previous
        int64 [N]; hypotheses of the trajectories at the previous update, negative for none: groups of one
        hypothesis are merged more easily, groups of different ones less.
    """

    def __init__(
        self,
        similarity: Floats32,
        distance: Floats32,
        superclusters: Ints,
        consensus: Floats,
        geometry: Geometry,
        smallest: int,
        previous: Labels | None,
    ) -> None:
        self._similarities, self._distance = similarity, distance
        self._geometry = geometry
        self._size = np.bincount(superclusters).astype(np.float64)
        self._members = [np.flatnonzero(superclusters == k) for k in range(len(self._size))]
        self._sums = sums_over_groups(sums_over_groups(similarity, superclusters).T, superclusters)
        self._consensus = consensus * np.outer(self._size, self._size)
        self._open = np.ones(len(self._size), np.bool_)
        self._previous = previous
        self._decided: dict[tuple[int, int], bool] = {}
        self._group = np.arange(len(self._size))
        self._smallest = max(smallest, _SMALLEST_SHARE * self._size.sum())

    def groups(self) -> Ints:
        """Group of every supercluster, intp [P], as the index of a supercluster in it."""
        while (pair := self._best_pair()) is not None:
            self._join(*pair)
        self._dissolve()
        return self._group

    def _join(self, first: int, second: int) -> None:
        """The smaller goes into the larger."""
        a, b = (first, second) if self._size[first] >= self._size[second] else (second, first)
        for sums in (self._sums, self._consensus):
            sums[a] += sums[b]
            sums[:, a] += sums[:, b]
        self._size[a] += self._size[b]
        self._members[a] = np.concatenate([self._members[a], self._members[b]])
        self._open[b] = False
        self._group[self._group == b] = a
        self._decided = {pair: m for pair, m in self._decided.items() if a not in pair and b not in pair}

    def _best_pair(self) -> tuple[int, int] | None:
        """The pair that merges and has most consensus, similarity beside it, if any."""
        smaller = np.minimum(self._size[:, None], self._size[None])
        similarity = np.triu(self._similarity(), 1)
        ratio = similarity / (SIMILARITY * np.sqrt(smaller / _SIZE))
        pairs = np.flatnonzero(ratio > 0)
        order = (self._consensus / np.outer(self._size, self._size)).flat[pairs]
        order += _SIMILARITY_IN_ORDER * np.log(similarity.flat[pairs])
        for flat in pairs[np.argsort(-order, kind="stable")].tolist():
            a, b = divmod(flat, len(ratio))
            if self._merges(a, b, float(ratio[a, b])):
                return a, b
        return None

    def _dissolve(self) -> None:
        """Groups that are too small go to the most similar group, the smallest first."""
        while self._open.sum() > 1:
            groups = np.flatnonzero(self._open)
            smallest = int(groups[np.argmin(self._size[groups])])
            if self._size[smallest] >= self._smallest:
                return
            self._join(int(np.argmax(self._similarity()[smallest])), smallest)

    def _similarity(self) -> Floats:
        mean: Floats = self._sums / np.outer(self._size, self._size)
        mean[~self._open] = -1
        mean[:, ~self._open] = -1
        np.fill_diagonal(mean, -1)
        return mean

    def _merges(self, a: int, b: int, ratio: float) -> bool:
        if min(self._size[a], self._size[b]) < self._smallest:
            return ratio >= 1
        if (a, b) not in self._decided:
            groups = self._members[a], self._members[b]
            if self._one_body(a, b, ratio):
                self._decided[a, b] = not self._geometry.two_bodies(*groups)
            else:
                self._decided[a, b] = self._geometry.one_body(*groups)
        return self._decided[a, b]

    def _one_body(self, a: int, b: int, ratio: float) -> bool:
        """Whether consensus, contrast and what they were before are evidence enough."""
        evidence = self._hysteresis(a, b)
        evidence += _CONSENSUS_WEIGHT * self._consensus[a, b] / (self._size[a] * self._size[b])
        contrast = self._contrast(*sorted((self._members[a], self._members[b]), key=len))
        if contrast is None:
            return bool(np.log(ratio) + evidence >= 0)
        drop, distance = contrast
        return bool(evidence + drop + np.log1p(distance) >= _LEAST_EVIDENCE)

    def _contrast(self, small: Ints, large: Ints) -> tuple[float, float] | None:
        """How similarity changes across the boundary of two groups; None if they are never seen together.

        The image motion of one rigid body varies from place to place as depth does, but trajectories that
        lie side by side on it are still similar. Where two bodies meet, they are not.

        Returns
        -------
        Mean log similarity of the smaller group's members to their nearest in the other one, less that to
        their nearest in their own; and median distance to the former, px.
        """
        picked = small
        if len(small) > _COMPARED:
            picked = small[(np.arange(_COMPARED) * len(small)) // _COMPARED]
        across, distance = self._to_nearest(picked, large)
        within, _ = self._to_nearest(picked, small)
        comparable = np.isfinite(distance) & np.isfinite(within)
        if not comparable.any():
            return None
        return float((across - within)[comparable].mean()), float(np.median(distance[comparable]))

    def _to_nearest(self, picked: Ints, others: Ints) -> tuple[Floats, Floats]:
        """Log mean similarity of the picked to their nearest others, NaN of none; mean distance in px."""
        distance = np.where(picked[:, None] == others, np.inf, self._distance[np.ix_(picked, others)])
        nearest = np.argpartition(distance, min(_NEAREST, len(others)) - 1, axis=1)[:, :_NEAREST]
        to_nearest = np.take_along_axis(distance, nearest, axis=1)
        seen = np.isfinite(to_nearest)
        count = seen.sum(axis=1)
        similarity = np.where(seen, self._similarities[picked[:, None], others[nearest]], 0).sum(axis=1)
        share = np.maximum(count, 1)
        return (
            np.where(count > 0, np.log(similarity / share + _SIMILARITY_FLOOR), np.nan),
            np.where(count > 0, np.where(seen, to_nearest, 0).sum(axis=1) / share, np.inf),
        )

    def _hysteresis(self, a: int, b: int) -> float:
        """Positive for groups of one previous hypothesis, negative for groups of two."""
        first, second = (self._previous_hypothesis(self._members[group]) for group in (a, b))
        if first is None or second is None:
            return 0.0
        return _HELD_TOGETHER if first == second else -_HELD_APART

    def _previous_hypothesis(self, members: Ints) -> int | None:
        """The most frequent one of the members, None if most had none."""
        if self._previous is None:
            return None
        ids, counts = np.unique(self._previous[members], return_counts=True)
        best = int(ids[counts.argmax()])
        return best if best >= 0 else None
