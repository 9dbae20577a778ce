"""Similarity and evidence of all pairs in; clusters of average linkage, and sums over clusters, out."""

import numpy as np

from ...arrays import Bools, Floats, Floats32, Ints
from ...compiled import compiled


@compiled()
def sum_over_groups(value: Floats32, evidence: Floats32, labels: Ints, groups: int) -> tuple[Floats, Floats]:
    """Sums over each group of evidence times value, and of evidence, to every trajectory, [K, N] each."""
    weighted, total = np.zeros((groups, len(value))), np.zeros((groups, len(value)))
    for i in range(len(value)):
        a, b = weighted[labels[i]], total[labels[i]]
        for j in range(len(a)):
            a[j] += value[i, j] * evidence[i, j]
            b[j] += evidence[i, j]
    return weighted, total


@compiled()
def pair_sums(value: Floats32, evidence: Floats32) -> Floats32:
    """Evidence times value beside evidence, [N, N, 2]: linkage spends its time on fetching both."""
    sums = np.empty((*value.shape, 2), np.float32)
    for i in range(len(value)):
        for j in range(len(value)):
            sums[i, j, 0] = value[i, j] * evidence[i, j]
            sums[i, j, 1] = evidence[i, j]
    return sums


@compiled()
def average_linkage(sums: Floats32, least: np.float32) -> Ints:
    """Root of every item's cluster, intp [N], by average linkage down to a mean of `least`.

    Nearest-neighbour chain: a ratio of sums lies between the ratios it is made of, so that linkage
    is reducible and any order of reciprocal neighbours gives the same tree in O(N²) (Murtagh 1983). For
    the same reason a cluster whose nearest neighbour is too far is final.

    Parameters
    ----------
    sums
        float32 [N, N, 2], see :func:`pair_sums`; used up.
    least
        Clusters of a smaller mean similarity are not linked.
    """
    count = len(sums)
    open_ = np.ones(count, np.bool_)
    parent = np.arange(count)
    chain = np.empty(count + 1, np.intp)
    length = start = 0
    while start < count:
        if length == 0:
            if not open_[start]:
                start += 1
                continue
            chain[0] = start
            length = 1
        a = chain[length - 1]
        before = chain[length - 2] if length > 1 else -1
        b, best = _nearest_cluster(sums, open_, a, before)
        if b < 0 or best < least:
            open_[a] = False
            length -= 1
        elif b == before:
            length -= 2
            parent[b] = a
            _join(sums, open_, a, b)
        elif length == count:
            # A symmetric matrix cannot make a chain longer than its items; no other may run off the end.
            open_[a] = False
            length = 0
        else:
            chain[length] = b
            length += 1
    return _roots(parent)


@compiled()
def _nearest_cluster(sums: Floats32, open_: Bools, a: int, before: int) -> tuple[int, np.float32]:
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
def _join(sums: Floats32, open_: Bools, a: int, b: int) -> None:
    """Add b's sums to a's and close b."""
    open_[b] = False
    for j in range(len(sums)):
        if open_[j]:
            for k in range(2):
                sums[a, j, k] += sums[b, j, k]
                sums[j, a, k] = sums[a, j, k]


@compiled()
def _roots(parent: Ints) -> Ints:
    for i in range(len(parent)):
        root = parent[i]
        while parent[root] != root:
            root = parent[root]
        parent[i] = root
    return parent
