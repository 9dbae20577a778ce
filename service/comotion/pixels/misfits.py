"""Trajectories that their own group's motion contradicts while another group's explains them.

Linkage compares neighbours, and a local motion that is fitted across a border explains a little of
both sides. What lies at the border of one body but far from the rest of its own can so end in the
other. The motion of whole groups tells.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled
from .keyframes import Floats32, KeyFrames

_STEP = 4
_LEAST_MEMBERS = 8
_LEAST_PAIRS = 3
_RIDGE_PX2 = 25.0
_ROUNDS = 3
_NOISE_PX = 0.3
# Squared deviations over the variance per axis of the group's own: two axes add up to 2 on average.
_EXPLAINED = 3.0
_CONTRADICTED = 16.0
_CAP = 25.0
# Median of the sum of two squared standard normal deviates.
_MEDIAN = 1.386

Labels = NDArray[np.intp]
Floats = NDArray[np.float64]


class Reassigned(NamedTuple):
    """Groups of N trajectories after misfits have gone over.

    Attributes
    ----------
    labels
        intp [N], 0 to K − 1.
    explained
        bool [K, N]; whether a trajectory deviates from a group's motion no more than members do. False
        where no pair of key frames shows it.
    """

    labels: Labels
    explained: NDArray[np.bool_]


def reassign(frames: KeyFrames, labels: Labels) -> Reassigned:
    """Change the labels of misfits to the group that explains them.

    A misfit deviates from its group's motion by more than four standard deviations in two pairs of
    key frames, and no more than members do, on average, from another group's. The motion of a group
    over a pair is an affine displacement field. In strong perspective that explains no group well;
    the deviations are large then, and so is what members deviate by.

    Parameters
    ----------
    frames
        F key frames of N trajectories.
    labels
        intp [N], 0 to K − 1.
    """
    pairs, groups = len(frames.positions) - _STEP, int(labels.max()) + 1
    if pairs < _LEAST_PAIRS or groups < 2:
        return Reassigned(labels, np.zeros((groups, len(labels)), np.bool_))
    positions = np.ascontiguousarray(frames.positions.transpose(0, 2, 1))
    own, every = _deviations(positions, frames.visible, labels, groups)
    known = np.isfinite(own) & np.isfinite(every)
    count = known.sum(axis=1)
    mean = np.where(known, np.minimum(every, _CAP), 0).sum(axis=1) / np.maximum(count, 1)
    explained = (mean < _EXPLAINED) & (count > 0)
    both = (frames.visible[_STEP:] & frames.visible[:pairs]).sum(axis=0)
    contradicted = np.partition(np.where(known, own, 0), -2, axis=1)[:, -2] > _CONTRADICTED
    fits = contradicted & explained & (count >= _LEAST_PAIRS) & (2 * count >= both)
    best = np.where(fits, mean, np.inf).argmin(axis=0)
    kept, labels = np.unique(np.where(fits.any(axis=0), best, labels), return_inverse=True)
    return Reassigned(labels, explained[kept])


@compiled()
def _deviations(
    positions: Floats32, visible: NDArray[np.bool_], labels: Labels, groups: int
) -> tuple[Floats, Floats]:
    """Squared deviations from the own group's motion [Q, N] and from every group's [K, Q, N].

    Infinite where a pair does not show the trajectory, or too few of the group. Away from the members
    a prediction is uncertain. That excuses from the own group, but does not recommend another.
    """
    pairs = len(positions) - _STEP
    own = np.full((pairs, positions.shape[2]), np.inf)
    every = np.full((groups, pairs, positions.shape[2]), np.inf)
    for q in range(pairs):
        seen = visible[q] & visible[q + _STEP]
        x = positions[q].astype(np.float64)
        move = positions[q + _STEP] - x
        for g in range(groups):
            members = np.flatnonzero(seen & (labels == g))
            if len(members) < _LEAST_MEMBERS:
                continue
            field = _fit(x, move, members)
            for i in range(positions.shape[2]):
                if seen[i]:
                    square, leverage = _apply(field, x[0, i], x[1, i], move[0, i], move[1, i])
                    every[g, q, i] = square / field[-1]
                    if labels[i] == g:
                        own[q, i] = square / (field[-1] * (1 + leverage))
    return own, every


@compiled()
def _fit(x: Floats, move: Floats, members: Labels) -> Floats:
    """Affine displacement field by reweighted least squares with a ridge.

    Centre of positions and of displacements (4), matrix by rows (4), inverse of the normal matrix
    (xx, xy, yy), sum of weights, variance per axis in px².
    """
    field = np.zeros(13)
    weight = np.ones(len(members))
    square = np.empty(len(members))
    for _ in range(_ROUNDS):
        n = weight.sum()
        field[:4] = 0
        for k, i in enumerate(members):
            for c in range(2):
                field[c] += weight[k] * x[c, i] / n
                field[2 + c] += weight[k] * move[c, i] / n
        xx = yy = n * _RIDGE_PX2
        xy = ux = uy = vx = vy = 0.0
        for k, i in enumerate(members):
            w, px, py = weight[k], x[0, i] - field[0], x[1, i] - field[1]
            pu, pv = move[0, i] - field[2], move[1, i] - field[3]
            xx, xy, yy = xx + w * px * px, xy + w * px * py, yy + w * py * py
            ux, uy, vx, vy = ux + w * pu * px, uy + w * pu * py, vx + w * pv * px, vy + w * pv * py
        det = xx * yy - xy * xy
        field[8], field[9], field[10], field[11] = yy / det, -xy / det, xx / det, n
        field[4], field[5] = ux * field[8] + uy * field[9], ux * field[9] + uy * field[10]
        field[6], field[7] = vx * field[8] + vy * field[9], vx * field[9] + vy * field[10]
        for k, i in enumerate(members):
            square[k], _ = _apply(field, x[0, i], x[1, i], move[0, i], move[1, i])
        field[12] = max(np.median(square) / _MEDIAN, _NOISE_PX**2)
        weight = 1 / (1 + square / (4 * field[12]))
    return field


@compiled()
def _apply(field: Floats, x: float, y: float, u: float, v: float) -> tuple[float, float]:
    """Squared residual, px², and how uncertain the prediction is in units of the variance."""
    dx, dy = x - field[0], y - field[1]
    ru = u - field[2] - field[4] * dx - field[5] * dy
    rv = v - field[3] - field[6] * dx - field[7] * dy
    leverage = 1 / field[11] + field[8] * dx * dx + 2 * field[9] * dx * dy + field[10] * dy * dy
    return ru * ru + rv * rv, leverage
