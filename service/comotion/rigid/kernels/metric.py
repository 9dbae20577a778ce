"""Compiled: symmetric matrices [6], xx, xy, xz, yy, yz, zz, that weigh residuals by direction."""

from ...arrays import Floats
from ...compiled import compiled


@compiled()
def is_round_metric(metric: Floats) -> bool:
    """Whether the noise of a metric [6] is the same in all directions."""
    return bool(metric[0] == 1.0 and metric[3] == 1.0 and metric[5] == 1.0)


@compiled()
def quadratic(m: Floats, a: float, b: float, c: float) -> float:
    """The square of a vector under a metric [6]."""
    across = m[1] * a * b + m[2] * a * c + m[4] * b * c
    return float(m[0] * a * a + m[3] * b * b + m[5] * c * c + 2.0 * across)


@compiled()
def squared_length(m: Floats, R: Floats, a: float, b: float, c: float, is_round: bool) -> float:
    """The square of a vector in the frame of a body, under a metric [6] of the axes of the space.

    `R` [9 or more] is the rotation of the body, row by row.
    """
    if is_round:
        return a * a + b * b + c * c
    u, v = R[0] * a + R[1] * b + R[2] * c, R[3] * a + R[4] * b + R[5] * c
    return quadratic(m, u, v, R[6] * a + R[7] * b + R[8] * c)
