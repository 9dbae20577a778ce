"""Pieces: average linkage of trajectories, weighted by evidence (METHOD-pixels step 5)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .keyframes import Floats32
from .similarity import Similarity


@dataclass(frozen=True)
class Pieces:
    """P groups of trajectories that certainly belong together.

    Attributes
    ----------
    of
        intp [N], the piece of every trajectory.
    weighted, evidence
        float64 [P, P]; sums over pairs of evidence times similarity, and of evidence. Both are
        additive when pieces merge.
    """

    of: NDArray[np.intp]
    weighted: NDArray[np.float64]
    evidence: NDArray[np.float64]

    def members(self) -> list[NDArray[np.intp]]:
        """Trajectories of every piece."""
        return [np.flatnonzero(self.of == k) for k in range(len(self.weighted))]


def link(similarity: Similarity, least: float) -> Pieces:
    """Link trajectories down to a mean similarity of `least`."""
    roots = _average_linkage(_beside(similarity.value, similarity.evidence), np.float32(least))
    _, of = np.unique(roots, return_inverse=True)
    weighted, evidence = pool(similarity, of)
    return Pieces(of, _by_piece(weighted, of), _by_piece(evidence, of))


def pool(similarity: Similarity, of: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sums of evidence times similarity, and of evidence, of P groups (`of`, intp [N]) to N trajectories."""
    return _pool(similarity.value, similarity.evidence, of, int(of.max()) + 1)


@compiled()
def _pool(
    value: Floats32, evidence: Floats32, of: NDArray[np.intp], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    weighted, total = np.zeros((count, len(value))), np.zeros((count, len(value)))
    for i in range(len(value)):
        a, b = weighted[of[i]], total[of[i]]
        for j in range(len(a)):
            a[j] += value[i, j] * evidence[i, j]
            b[j] += evidence[i, j]
    return weighted, total


def _by_piece(sums: NDArray[np.float64], of: NDArray[np.intp]) -> NDArray[np.float64]:
    """Sums [P, P] of columns of one piece."""
    return sums @ np.eye(len(sums))[of]


@compiled()
def _beside(value: Floats32, evidence: Floats32) -> Floats32:
    """Weighted similarity beside evidence, float32 [N, N, 2]."""
    sums = np.empty((*value.shape, 2), np.float32)
    for i in range(len(value)):
        for j in range(len(value)):
            sums[i, j, 0] = value[i, j] * evidence[i, j]
            sums[i, j, 1] = evidence[i, j]
    return sums


@compiled()
def _average_linkage(sums: Floats32, least: np.float32) -> NDArray[np.intp]:
    """Root of every item's cluster, intp [N].

    `sums` [N, N, 2], weighted similarity beside evidence, is used up. They lie side by side because
    the time goes into fetching columns from memory.

    Nearest-neighbour chain: a ratio of sums lies between the ratios it is made of, so that linkage
    is reducible and any order of reciprocal neighbours gives the same tree in O(N²). For the same
    reason a cluster whose nearest neighbour is too far is final.
    """
    count = len(sums)
    open_ = np.ones(count, np.bool_)
    parent = np.arange(count)
    chain = np.empty(count + 1, np.intp)
    length = 0
    start = 0
    while start < count:
        if length == 0:
            if not open_[start]:
                start += 1
                continue
            chain[0] = start
            length = 1
        a = chain[length - 1]
        before = chain[length - 2] if length > 1 else -1
        b, best = _nearest(sums, open_, a, before)
        if b < 0 or best < least:
            open_[a] = False
            length -= 1
        elif b == before:
            length -= 2
            open_[b] = False
            parent[b] = a
            _absorb(sums, open_, a, b)
        elif length == count:
            # A symmetric matrix cannot make a chain longer than its items; no other may run off the end.
            open_[a] = False
            length = 0
        else:
            chain[length] = b
            length += 1
    return _roots(parent)


@compiled()
def _nearest(sums: Floats32, open_: NDArray[np.bool_], a: int, before: int) -> tuple[int, np.float32]:
    """The most similar open cluster, `before` among equals, so that a chain cannot turn in circles."""
    b = before
    best = sums[a, b, 0] / sums[a, b, 1] if b >= 0 else np.float32(-1)
    for j in range(len(sums)):
        if open_[j] and j != a:
            value = sums[a, j, 0] / sums[a, j, 1]
            if value > best:
                best = value
                b = j
    return b, best


@compiled()
def _absorb(sums: Floats32, open_: NDArray[np.bool_], a: int, b: int) -> None:
    """Add b's sums to a's."""
    for j in range(len(sums)):
        if open_[j]:
            for k in range(2):
                sums[a, j, k] += sums[b, j, k]
                sums[j, a, k] = sums[a, j, k]


@compiled()
def _roots(parent: NDArray[np.intp]) -> NDArray[np.intp]:
    for i in range(len(parent)):
        root = parent[i]
        while parent[root] != root:
            root = parent[root]
        parent[i] = root
    return parent
