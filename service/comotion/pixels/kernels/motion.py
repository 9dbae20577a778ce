"""Rates how well the recent motion of a group explains that of each trajectory.

The motion of a group is a displacement as a function of place: affine for few members, quadratic for many.
"""

import numpy as np

from ...arrays import Bools, Floats, Ints
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
) -> tuple[Floats, Bools]:
    """Least gain over S time scales under the motion of the members, [n], and whether it is known, bool [n].

    Of positions [n, 2] and displacements up to them [S, n, 2], where `seen` [S, n]. `variance` [n] is the
    noise of a coordinate in px², `drift` [S] px what adds to it. A time scale counts if enough members were
    seen over it.
    """
    gain, measured = np.ones(len(position)), np.zeros(len(position), np.bool_)
    for k in range(len(drift)):
        rows = np.flatnonzero(members & seen[k])
        if len(rows) < _LEAST_MEMBERS:
            continue
        measured |= seen[k]
        step = displacement[k]
        expected = _expected(position - step, step, rows)
        # Members have drawn the motion towards themselves.
        own = len(rows) / (len(rows) - 3)
        for i in np.flatnonzero(seen[k]):
            square = ((step[i] - expected[i]) ** 2).sum()
            width = 2 * (variance[i] + drift[k] ** 2) + _DEVIATION**2 * (expected[i] ** 2).sum()
            gain[i] = min(gain[i], max(1 - (own if members[i] else 1.0) * square / (GATE * width), WORST))
    return np.where(measured, gain, 0.0), measured


@compiled()
def _expected(start: Floats, step: Floats, rows: Ints) -> Floats:
    """Displacements [n, 2] at places [n, 2] by the field that fits those of some rows."""
    centre = np.array([start[rows, 0].mean(), start[rows, 1].mean()])
    extent = max(np.sqrt(((start[rows] - centre) ** 2).sum() / len(rows) / 2), 1.0)
    x, y = (start[:, 0] - centre[0]) / extent, (start[:, 1] - centre[1]) / extent
    terms = np.ones((len(start), 6 if len(rows) >= _LEAST_QUADRATIC else 3))
    terms[:, 1], terms[:, 2] = x, y
    if len(rows) >= _LEAST_QUADRATIC:
        terms[:, 3], terms[:, 4], terms[:, 5] = x * x, x * y, y * y
    ridge = np.zeros(terms.shape[1])
    ridge[1:3], ridge[3:] = max(_RIDGE_PX2 / extent**2, _LEAST_RIDGE), _QUADRATIC_RIDGE
    fitted, target = terms[rows], np.ascontiguousarray(step[rows])
    field = np.zeros((2, terms.shape[1])).T
    square = (target[:, 0] - np.median(target[:, 0])) ** 2 + (target[:, 1] - np.median(target[:, 1])) ** 2
    for _ in range(_ROUNDS):
        variance = max(np.median(square) / _CHI2_MEDIAN_2D, _LEAST_VARIANCE)
        weight = (1 + square / (4 * variance)) ** -2
        weighted = (fitted * weight.reshape(-1, 1)).T
        field = np.linalg.solve(weighted @ fitted + weight.sum() * np.diag(ridge), weighted @ target)
        residual = target - fitted @ field
        square = residual[:, 0] ** 2 + residual[:, 1] ** 2
    return terms @ field
