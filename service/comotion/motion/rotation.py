"""Compiled: the rotation that best turns one set of points to another."""

import numpy as np

from ..pixels.compiled import compiled
from ..window import Floats

_SWEEPS = 12
_CONVERGED = 1e-22


@compiled()
def planar_rotation(H: Floats, R: Floats) -> None:
    """R about z that maximises tr(R^T H), H = sum w (y - ybar)(b - bbar)^T [3, 3]."""
    c, s = H[0, 0] + H[1, 1], H[1, 0] - H[0, 1]
    length = np.sqrt(c * c + s * s)
    c, s = (c / length, s / length) if length > 0 else (1.0, 0.0)
    R[:] = 0.0
    R[0, 0] = R[1, 1] = c
    R[1, 0], R[0, 1] = s, -s
    R[2, 2] = 1.0


@compiled()
def spatial_rotation(H: Floats, R: Floats) -> None:
    """R that maximises tr(R^T H), H = sum w (y - ybar)(b - bbar)^T [3, 3] (Horn 1987, eq. 37 ff.).

    The quaternion is the eigenvector of the largest eigenvalue of a symmetric 4 x 4 form; Jacobi
    rotations find it whatever the rank of H.
    """
    A, V = _horn_form(H), np.eye(4)
    scale = (A * A).sum()
    for _ in range(_SWEEPS):
        if _off_diagonal(A) <= _CONVERGED * scale:
            break
        for p in range(3):
            for q in range(p + 1, 4):
                if A[p, q] != 0.0:
                    _annihilate(A, V, p, q)
    best = 0
    for k in range(1, 4):
        if A[k, k] > A[best, best]:
            best = k
    _from_quaternion(V[0, best], V[1, best], V[2, best], V[3, best], R)


@compiled()
def _horn_form(H: Floats) -> Floats:
    A = np.zeros((4, 4))
    A[0, 0] = H[0, 0] + H[1, 1] + H[2, 2]
    A[1, 1] = H[0, 0] - H[1, 1] - H[2, 2]
    A[2, 2] = -H[0, 0] + H[1, 1] - H[2, 2]
    A[3, 3] = -H[0, 0] - H[1, 1] + H[2, 2]
    A[0, 1] = A[1, 0] = H[2, 1] - H[1, 2]
    A[0, 2] = A[2, 0] = H[0, 2] - H[2, 0]
    A[0, 3] = A[3, 0] = H[1, 0] - H[0, 1]
    A[1, 2] = A[2, 1] = H[0, 1] + H[1, 0]
    A[1, 3] = A[3, 1] = H[0, 2] + H[2, 0]
    A[2, 3] = A[3, 2] = H[1, 2] + H[2, 1]
    return A


@compiled()
def _off_diagonal(A: Floats) -> float:
    total = 0.0
    for p in range(3):
        for q in range(p + 1, 4):
            total += A[p, q] * A[p, q]
    return total


@compiled()
def _annihilate(A: Floats, V: Floats, p: int, q: int) -> None:
    """One Jacobi rotation that makes A[p, q] vanish, collected in V."""
    theta = (A[q, q] - A[p, p]) / (2 * A[p, q])
    t = (1.0 if theta >= 0 else -1.0) / (abs(theta) + np.sqrt(theta * theta + 1))
    c = 1.0 / np.sqrt(t * t + 1)
    s = t * c
    for k in range(4):
        A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
    for k in range(4):
        A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
    for k in range(4):
        V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]


@compiled()
def _from_quaternion(w: float, x: float, y: float, z: float, R: Floats) -> None:
    R[0, 0], R[0, 1], R[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
