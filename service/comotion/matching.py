"""Matches old and new groups by the trajectories that they share."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from .arrays import Floats, Ints, Labels, distinct

Pairs = list[tuple[int, int]]


def shared_counts(
    previous_labels: Labels, groups: Ints, count: int, weights: Floats | None = None
) -> tuple[Labels, NDArray[Any]]:
    """Count the trajectories that old hypotheses and new groups share.

    `previous_labels` int64 [N] is the hypothesis of each trajectory until now and `groups` intp [N] the group
    of each, of `count`, both negative for none; `weights` float64 [N] says how much each counts, None: 1.
    Returns the old hypotheses int64 [H], ascending, and the counts int64 [H, count]; with weights float64.
    """
    labelled = previous_labels >= 0
    ids, row = distinct(previous_labels[labelled])
    both = groups[labelled] >= 0
    cells = row[both] * count + groups[labelled][both]
    weight = None if weights is None else weights[labelled][both]
    return ids, np.bincount(cells, weight, len(ids) * count).reshape(len(ids), count)


def largest_first(shared: NDArray[Any]) -> Pairs:
    """Label propagation of the thesis: the largest entry is a match, and strikes its row and column.

    It goes on until the largest entry is 0. Ties go to the older hypothesis, then to the first group. The
    entries are sorted once, and what is struck is skipped.
    """
    rows, columns = np.nonzero(shared)
    order = np.argsort(-shared[rows, columns], kind="stable")
    free_row, free_column = np.ones(shared.shape[0], np.bool_), np.ones(shared.shape[1], np.bool_)
    pairs = []
    for k, m in zip(rows[order].tolist(), columns[order].tolist(), strict=True):
        if free_row[k] and free_column[m]:
            pairs.append((k, m))
            free_row[k] = free_column[m] = False
    return pairs


def largest_total(shared: NDArray[Any]) -> Pairs:
    """The assignment with most shared trajectories in all (Kuhn 1955)."""
    rows, columns = linear_sum_assignment(-shared)
    return [(r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if shared[r, c] > 0]


def continued(
    previous_labels: Labels,
    groups: Ints,
    count: int,
    matching: Callable[[NDArray[Any]], Pairs],
    weights: Floats | None = None,
) -> dict[int, int]:
    """Hypothesis that each group continues, {group: id}; parameters as in :func:`shared_counts`."""
    ids, shared = shared_counts(previous_labels, groups, count, weights)
    return {group: int(ids[row]) for row, group in matching(shared)}
