"""Similarity of trajectories in; superclusters, which lie within one body each, out."""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats, Ints
from .kernels.linkage import average_linkage, pair_sums, sum_over_groups
from .similarity import Similarity

# Mean similarity down to which a group lies within one body: .15 % of the members are of another one on
# Hopkins155.
_LEAST_SIMILARITY = 0.08


@dataclass(frozen=True)
class Superclusters:
    """P groups of trajectories that belong together with near certainty.

    Attributes
    ----------
    of
        intp [N], the supercluster of every trajectory.
    weighted, evidence
        float64 [P, P]; sums over pairs of evidence times similarity, and of evidence. Both are
        additive when superclusters merge.
    """

    of: Ints
    weighted: Floats
    evidence: Floats

    def members(self) -> list[Ints]:
        """Trajectories of every supercluster."""
        return [np.flatnonzero(self.of == k) for k in range(len(self.weighted))]


def link(similarity: Similarity, least: float = _LEAST_SIMILARITY) -> Superclusters:
    """Average linkage of trajectories, weighted by evidence, down to a mean similarity of `least`."""
    roots = average_linkage(pair_sums(similarity.value, similarity.evidence), np.float32(least))
    _, of = np.unique(roots, return_inverse=True)
    weighted, evidence = pool(similarity, of)
    columns = np.eye(len(weighted))[of]
    return Superclusters(of, weighted @ columns, evidence @ columns)


def pool(similarity: Similarity, labels: Ints) -> tuple[Floats, Floats]:
    """Sums of evidence times similarity, and of evidence, of K groups to N trajectories, float64 [K, N].

    `labels` intp [N] are the groups.
    """
    return sum_over_groups(similarity.value, similarity.evidence, labels, int(labels.max()) + 1)
