"""Compiled: symmetric matrices [6], xx, xy, xz, yy, yz, zz, that weigh residuals by direction."""

from ...arrays import Floats
from ...compiled import compiled


@compiled()
def is_round_metric(metric: Floats) -> bool:
    """Whether the noise of a metric [6] is the same in all directions."""
    return bool(metric[0] == 1.0 and metric[3] == 1.0 and metric[5] == 1.0)


@compiled()
def turned_metric(m: Floats, R: Floats, turned: Floats) -> None:
    """R^T M R of a metric [6] and a rotation, row by row in R [9 or more], to [6]."""
    for c in range(3):
        a, b, e = R[c], R[3 + c], R[6 + c]
        u0, u1, u2 = (
            m[0] * a + m[1] * b + m[2] * e,
            m[1] * a + m[3] * b + m[4] * e,
            m[2] * a + m[4] * b + m[5] * e,
        )
        for d in range(c, 3):
            turned[c + d + (c > 0)] = u0 * R[d] + u1 * R[3 + d] + u2 * R[6 + d]


@compiled()
def quadratic(m: Floats, a: float, b: float, c: float) -> float:
    """The square of a vector under a metric [6]."""
    across = m[1] * a * b + m[2] * a * c + m[4] * b * c
    return float(m[0] * a * a + m[3] * b * b + m[5] * c * c + 2.0 * across)


@compiled()
def solved(m: Floats, a: float, b: float, c: float) -> tuple[float, float, float]:
    """M^-1 v of a symmetric matrix [6], positive definite."""
    c00, c01, c02 = m[3] * m[5] - m[4] * m[4], m[2] * m[4] - m[1] * m[5], m[1] * m[4] - m[2] * m[3]
    c11, c12, c22 = m[0] * m[5] - m[2] * m[2], m[1] * m[2] - m[0] * m[4], m[0] * m[3] - m[1] * m[1]
    inverse = 1.0 / (m[0] * c00 + m[1] * c01 + m[2] * c02)
    return (
        inverse * (c00 * a + c01 * b + c02 * c),
        inverse * (c01 * a + c11 * b + c12 * c),
        inverse * (c02 * a + c12 * b + c22 * c),
    )
