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
