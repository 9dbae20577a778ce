"""Readable twins of the compiled code in comotion.pixels.kernels: same arguments, float64, plain NumPy."""

import numpy as np


def fit_affine(x, y, u, v, w, ridge):
    """One field: its weighted means, centred normal matrix with ridge, and (a, b, c, d, e, f)."""
    points, moves = np.stack([x, y], 1), np.stack([u, v], 1)
    centre, mean = np.average(points, 0, w), np.average(moves, 0, w)
    normal = (points - centre).T @ ((points - centre) * w[:, None]) + ridge * w.sum() * np.eye(2)
    matrix = np.linalg.solve(normal, (points - centre).T @ ((moves - mean) * w[:, None])).T
    return centre, normal, np.array([*matrix.ravel(), *(mean - matrix @ centre)])


def residual(field, x, y, u, v):
    a, b, c, d, e, f = field
    return (u - a * x - b * y - e) ** 2 + (v - c * x - d * y - f) ** 2


def fit_local_motions(start, displacement, seen, members, ridge):
    motions = np.zeros((len(seen), members.shape[1], 6))
    used = np.zeros(motions.shape[:2])
    for q, h in np.ndindex(used.shape):
        inside = members[seen[q, members[:, h]] > 0, h]
        if len(inside) >= 4:
            columns = *start[q][:, inside], *displacement[q][:, inside]
            motions[q, h] = fit_affine(*columns, np.ones(len(inside)), ridge)[2]
            used[q, h] = 1
    return motions, used


def capped(start, displacement, seen, motions, caps):
    """Capped squared residuals [Q, H, N]."""
    return np.array(
        [
            [
                np.minimum(residual(m, *start[q], *displacement[q]) * seen[q], c)
                for m, c in zip(*row, strict=True)
            ]
            for q, row in enumerate(zip(motions, caps, strict=True))
        ]
    )


def total_residuals(start, displacement, seen, motions, caps):
    return capped(start, displacement, seen, motions, caps).sum(axis=0)


def robust_field(start, step):
    """Displacement as a function of place, fitted robustly; quadratic from twelve points on."""
    centre = start.mean(axis=0)
    extent = max(np.sqrt(((start - centre) ** 2).sum(axis=1).mean() / 2), 1.0)
    quadratic = len(start) >= 12

    def basis(place):
        x, y = ((place - centre) / extent).T
        linear = [np.ones(len(place)), x, y]
        return np.stack([*linear, x * x, x * y, y * y] if quadratic else linear, axis=1)

    ridge = np.diag([0.0] + 2 * [25.0 / extent**2] + quadratic * 3 * [0.1])
    rows = basis(start)
    square = ((step - np.median(step, axis=0)) ** 2).sum(axis=1)
    for _ in range(4):
        weight = (1 + square / (4 * max(np.median(square) / 1.386, 0.05))) ** -2
        normal = (weight[:, None] * rows).T @ rows + weight.sum() * ridge
        field = np.linalg.solve(normal, (weight[:, None] * rows).T @ step)
        square = ((step - rows @ field) ** 2).sum(axis=1)
    return lambda place: basis(place) @ field


def motion_gain(position, displacement, seen, variance, drift, members):
    gain, known, motion = np.ones(len(position)), np.zeros(len(position), bool), -1.0
    for step, there, extra in zip(displacement, seen, drift, strict=True):
        mine = members & there
        if mine.sum() < 4:
            continue
        start = position - step
        expected = robust_field(start[mine], step[mine])(start)
        square = ((step - expected) ** 2).sum(axis=1) * np.where(mine, mine.sum() / (mine.sum() - 3), 1)
        width = 2 * (variance + extra**2) + 0.15**2 * (expected**2).sum(axis=1)
        gain = np.where(there, np.minimum(gain, np.clip(1 - square / (9 * width), -3, 1)), gain)
        known |= there
        motion = max(motion, np.sqrt(np.median((step[mine] ** 2).sum(axis=1))))
    return np.where(known, gain, 0.0), motion
