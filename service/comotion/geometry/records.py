"""Rows, poses and metrics: arguments of kernels, as NamedTuples, which compiled code unpacks at no cost."""

from typing import NamedTuple

from ..arrays import Bools, Floats
from ..compiled import compiled

ROUND = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
"""Metric of noise that is the same in all directions."""


class RowArrays(NamedTuple):
    """P rows on F frames: `y` float64 [P, F, 3], `w` [P, F] (0: unobserved), `tolerance` [P].

    `spectrum` float64 [P, 3] are the white and the slow part of the noise, in tolerances, and the correlation
    of the slow part from frame to frame. `metric` float64 [P, 6] is the inverse covariance in units of the
    inverse tolerance: xx, xy, xz, yy, yz, zz; that of :data:`ROUND` where the noise is the same in all
    directions.
    """

    y: Floats
    w: Floats
    tolerance: Floats
    spectrum: Floats
    metric: Floats


class PoseArrays(NamedTuple):
    """Poses x = R b + t of a body: `R` float64 [F, 3, 3], `t` float64 [F, 3], `posed` bool [F]."""

    R: Floats
    t: Floats
    posed: Bools


@compiled()
def is_round_metric(metric: Floats) -> bool:
    """Whether the noise of a metric [6] is the same in all directions."""
    return bool(metric[0] == 1.0 and metric[3] == 1.0 and metric[5] == 1.0)


@compiled()
def quadratic(m: Floats, a: float, b: float, c: float) -> float:
    """The square of a vector under a metric [6]."""
    across = m[1] * a * b + m[2] * a * c + m[4] * b * c
    return float(m[0] * a * a + m[3] * b * b + m[5] * c * c + 2.0 * across)
