"""Rates how well the recent motion of a group explains that of each trajectory.

The motion of a group is a displacement as a function of place: affine for few members, quadratic for many.
"""

import numpy as np

from ...arrays import Bools, Floats
from ...compiled import compiled

GATE = 9.0
"""Squared standard deviations at which a gain is 0."""
WORST = -3.0
"""nat; least gain: what contradicts its hypothesis leaves it within two updates."""

# Fewer members explain themselves.
_LEAST_MEMBERS = 4
# From so many members on the motion is quadratic in place, as that of a ball, or of a page that is turned.
_LEAST_QUADRATIC = 12
# Share of its motion by which a member of a body may deviate: hands are not rigid.
_DEVIATION = 0.15
# Regularisation per member: px² of the linear part, and of the quadratic one at unit extent.
_RIDGE_PX2, _QUADRATIC_RIDGE = 25.0, 0.1
# The least of the linear part: one place far away makes all others one, and the fit singular.
_LEAST_RIDGE = 1e-9
# Rounds of reweighting in the robust fit.
_ROUNDS = 4
# px²; smallest variance of members about the motion of their group.
_LEAST_VARIANCE = 0.05
# Median of the sum of two squared standard normal deviates, 2 ln 2.
_CHI2_MEDIAN_2D = 1.386


@compiled()
def motion_gain(
    position: Floats, displacement: Floats, seen: Bools, variance: Floats, drift: Floats, members: Bools
) -> tuple[Floats, float]:
    """Least gain over S time scales under the motion of the members, [n], and their motion in px.

    Of positions [n, 2] and displacements up to them [S, n, 2], where `seen` [S, n]. `variance` [n] is the
    noise of a coordinate in px², `drift` [S] px what adds to it. The motion is the largest median over the
    time scales; negative where too few members were seen.
    """
    gain, measured = np.ones(len(position)), np.zeros(len(position), np.bool_)
    farthest = -1.0
    for k in range(len(drift)):
        rows = np.flatnonzero(members & seen[k])
        if len(rows) < _LEAST_MEMBERS:
            continue
        measured |= seen[k]
        start, step = position - displacement[k], displacement[k]
        centre, extent, field = _fit(start[rows], step[rows])
        farthest = max(farthest, np.sqrt(np.median(step[rows, 0] ** 2 + step[rows, 1] ** 2)))
        # Members have drawn the motion towards themselves.
        own = len(rows) / (len(rows) - 3)
        row = np.empty(len(field))
        for i in np.flatnonzero(seen[k]):
            square, expected = _deviation(start[i], step[i], centre, extent, field, row)
            slack = _DEVIATION**2 * expected
            width = 2 * (variance[i] + drift[k] ** 2) + slack
            gain[i] = min(gain[i], max(1 - (own if members[i] else 1.0) * square / (GATE * width), WORST))
    return np.where(measured, gain, 0.0), farthest


@compiled()
def _fit(start: Floats, step: Floats) -> tuple[Floats, float, Floats]:
    """Centre [2] and extent of places [n, 2], and the field [3 or 6, 2] of their displacements."""
    centre = np.array([start[:, 0].mean(), start[:, 1].mean()])
    extent = max(np.sqrt(((start - centre) ** 2).sum() / len(start) / 2), 1.0)
    rows = np.empty((len(start), 6 if len(start) >= _LEAST_QUADRATIC else 3))
    for j in range(len(start)):
        _terms(start[j], centre, extent, rows[j])
    ridge = np.zeros(rows.shape[1])
    ridge[1:3], ridge[3:] = max(_RIDGE_PX2 / extent**2, _LEAST_RIDGE), _QUADRATIC_RIDGE
    field = np.zeros((rows.shape[1], 2))
    square = (step[:, 0] - np.median(step[:, 0])) ** 2 + (step[:, 1] - np.median(step[:, 1])) ** 2
    for _ in range(_ROUNDS):
        variance = max(np.median(square) / _CHI2_MEDIAN_2D, _LEAST_VARIANCE)
        weight = (1 + square / (4 * variance)) ** -2
        weighted = (rows * weight.reshape(-1, 1)).T
        field = np.linalg.solve(weighted @ rows + weight.sum() * np.diag(ridge), weighted @ step)
        residual = step - rows @ field
        square = residual[:, 0] ** 2 + residual[:, 1] ** 2
    return centre, extent, field


@compiled()
def _terms(place: Floats, centre: Floats, extent: float, row: Floats) -> None:
    x, y = (place[0] - centre[0]) / extent, (place[1] - centre[1]) / extent
    row[0], row[1], row[2] = 1.0, x, y
    if len(row) > 3:
        row[3], row[4], row[5] = x * x, x * y, y * y


@compiled()
def _deviation(
    place: Floats, step: Floats, centre: Floats, extent: float, field: Floats, row: Floats
) -> tuple[float, float]:
    """Squared distance of a step from what a field expects at its place, and squared expected step, px²."""
    _terms(place, centre, extent, row)
    u = v = 0.0
    for a in range(len(row)):
        u += row[a] * field[a, 0]
        v += row[a] * field[a, 1]
    return (step[0] - u) ** 2 + (step[1] - v) ** 2, u * u + v * v
