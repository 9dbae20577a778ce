"""Compiled: the rotation that fits a moment matrix best, and conversions of rotations."""

import numpy as np

from ..arrays import Floats
from ..compiled import compiled

_STEPS = 8
ROUNDING = 1e-8
"""Share below which a number is rounding; rad, below which the sine of an angle is the angle, and after a
step of which the next one of Newton's method is below double precision."""


@compiled()
def newton_rotation(H: Floats, near: Floats, R: Floats) -> bool:
    """Whether Newton's method finds the maximum of tr(R^T H) over rotations, in place.

    With M = R^T H and R <- R exp([s]x), s solves (tr(S) 1 - S) s = axial(M), S the symmetric part. A
    stationary point with a positive definite matrix is the maximum: the others are saddles and the minimum.
    """
    for p in range(3):
        for q in range(3):
            R[p, q] = near[p, q]
    for _ in range(_STEPS):
        m00 = R[0, 0] * H[0, 0] + R[1, 0] * H[1, 0] + R[2, 0] * H[2, 0]
        m01 = R[0, 0] * H[0, 1] + R[1, 0] * H[1, 1] + R[2, 0] * H[2, 1]
        m02 = R[0, 0] * H[0, 2] + R[1, 0] * H[1, 2] + R[2, 0] * H[2, 2]
        m10 = R[0, 1] * H[0, 0] + R[1, 1] * H[1, 0] + R[2, 1] * H[2, 0]
        m11 = R[0, 1] * H[0, 1] + R[1, 1] * H[1, 1] + R[2, 1] * H[2, 1]
        m12 = R[0, 1] * H[0, 2] + R[1, 1] * H[1, 2] + R[2, 1] * H[2, 2]
        m20 = R[0, 2] * H[0, 0] + R[1, 2] * H[1, 0] + R[2, 2] * H[2, 0]
        m21 = R[0, 2] * H[0, 1] + R[1, 2] * H[1, 1] + R[2, 2] * H[2, 1]
        m22 = R[0, 2] * H[0, 2] + R[1, 2] * H[1, 2] + R[2, 2] * H[2, 2]
        a, d, f = m11 + m22, m00 + m22, m00 + m11
        b, c, e = -0.5 * (m01 + m10), -0.5 * (m02 + m20), -0.5 * (m12 + m21)
        # The matrix as L D L^T; it is positive definite if every pivot is positive.
        if a <= 0:
            return False
        l1, l2 = b / a, c / a
        d2 = d - l1 * b
        if d2 <= ROUNDING * d:
            return False
        k = e - l1 * c
        l3 = k / d2
        d3 = f - l2 * c - l3 * k
        if d3 <= ROUNDING * f:
            return False
        u0, u1, u2 = m21 - m12, m02 - m20, m10 - m01
        u1 -= l1 * u0
        u2 -= l2 * u0 + l3 * u1
        s2 = u2 / d3
        s1 = u1 / d2 - l3 * s2
        s0 = u0 / a - l1 * s1 - l2 * s2
        size = s0 * s0 + s1 * s1 + s2 * s2
        if size > 1.0:
            return False
        _turn(R, 0.5 * s0, 0.5 * s1, 0.5 * s2)
        if size < ROUNDING * ROUNDING:
            return True
    return False


@compiled()
def _turn(R: Floats, x: float, y: float, z: float) -> None:
    """R times the rotation of the quaternion (1, x, y, z), normalised."""
    n = 2.0 / (1.0 + x * x + y * y + z * z)
    a, b, c = 1 - n * (y * y + z * z), n * (x * y - z), n * (x * z + y)
    d, e, f = n * (x * y + z), 1 - n * (x * x + z * z), n * (y * z - x)
    g, h, i = n * (x * z - y), n * (y * z + x), 1 - n * (x * x + y * y)
    for p in range(3):
        r0, r1, r2 = R[p, 0], R[p, 1], R[p, 2]
        R[p, 0] = r0 * a + r1 * d + r2 * g
        R[p, 1] = r0 * b + r1 * e + r2 * h
        R[p, 2] = r0 * c + r1 * f + r2 * i


@compiled()
def closed_form(H: Floats, R: Floats) -> None:
    """The maximum of tr(R^T H) over rotations, whatever the rank of H (Horn 1987, eq. 37 ff.)."""
    x, y, z, w = quaternion(H)
    _from_quaternion(w, x, y, z, R)


@compiled()
def quaternion(H: Floats) -> Floats:
    """That maximum, or H [3, 3] itself if it is a rotation, as a unit quaternion (x, y, z, w).

    It is the eigenvector of the largest eigenvalue of a form. The first of w, x, y, z that is not zero is
    positive.
    """
    A = np.zeros((4, 4))
    # LAPACK reads the lower triangle.
    A[0, 0] = H[0, 0] + H[1, 1] + H[2, 2]
    A[1, 1] = H[0, 0] - H[1, 1] - H[2, 2]
    A[2, 2] = -H[0, 0] + H[1, 1] - H[2, 2]
    A[3, 3] = -H[0, 0] - H[1, 1] + H[2, 2]
    A[1, 0], A[2, 0], A[3, 0] = H[2, 1] - H[1, 2], H[0, 2] - H[2, 0], H[1, 0] - H[0, 1]
    A[2, 1], A[3, 1], A[3, 2] = H[0, 1] + H[1, 0], H[0, 2] + H[2, 0], H[1, 2] + H[2, 1]
    q = np.linalg.eigh(A)[1][:, 3]
    for value in q:
        if value != 0:
            return np.roll(q if value > 0 else -q, -1)
    return np.roll(q, -1)


@compiled()
def _from_quaternion(w: float, x: float, y: float, z: float, R: Floats) -> None:
    """Rotation matrix of a unit quaternion, in place."""
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled()
def rotation_vectors(R: Floats) -> Floats:
    """Rotation vectors of R [n, 3, 3], [n, 3]; at half a turn the axis is undetermined and may be zero."""
    vectors = np.zeros((len(R), 3))
    for n in range(len(R)):
        x, y, z = R[n, 2, 1] - R[n, 1, 2], R[n, 0, 2] - R[n, 2, 0], R[n, 1, 0] - R[n, 0, 1]
        sine = 0.5 * np.sqrt(x * x + y * y + z * z)
        angle = np.arctan2(sine, 0.5 * (R[n, 0, 0] + R[n, 1, 1] + R[n, 2, 2] - 1.0))
        scale = 0.5 * angle / sine if sine > 0 else 0.5
        vectors[n, 0], vectors[n, 1], vectors[n, 2] = scale * x, scale * y, scale * z
    return vectors


@compiled()
def rotation_matrix(v: Floats) -> Floats:
    """Rotation by a vector [3], [3, 3]."""
    R = np.zeros((3, 3))
    angle = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    s = 0.5 if angle < ROUNDING else np.sin(0.5 * angle) / angle
    _from_quaternion(np.cos(0.5 * angle), s * v[0], s * v[1], s * v[2], R)
    return R
