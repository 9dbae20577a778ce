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


def pair_activity(start, displacement, seen, motions, caps):
    square = capped(start, displacement, seen, motions[:, ::8], caps[:, ::8])
    trials = (caps[:, ::8] > 0).sum(axis=1) * seen.sum(axis=1)
    return (square / (square + 1)).sum(axis=(1, 2)) / np.maximum(trials, 1)


def mean_residuals(total, count, pattern):
    n = count[pattern]
    return np.where(n > 0, total / np.maximum(n, 1), np.inf)


def weigh_preferences(preferred, coverage, pattern):
    """Weighted preferences and the sums of weighted squares by pattern."""
    value = np.where(preferred >= 1e-6, preferred, 0)
    weighted = coverage[pattern] * value
    return weighted, np.array([(weighted * value)[pattern == p].sum(axis=0) for p in range(len(coverage))])


def tanimoto(both, own, covered, pattern, floor):
    """Kernel and evidence from the upper triangle of Σab."""
    squares = own[:, pattern]
    upper = np.triu(both / np.maximum(squares + squares.T - both, 1e-12))
    return upper + np.triu(upper, 1).T, covered[np.ix_(pattern, pattern)] + floor


def sum_over_groups(value, evidence, labels, groups):
    member = np.arange(groups)[:, None] == labels
    return member @ (value * evidence), member @ evidence


def pair_sums(value, evidence):
    return np.stack([value * evidence, evidence], axis=-1)


def average_linkage(sums, least):
    """Clusters as sorted lists of items, by greedy linkage."""
    clusters = [[i] for i in range(len(sums))]
    while len(clusters) > 1:
        mean = {}
        for a in range(len(clusters)):
            for b in range(a):
                weighted, evidence = sums[np.ix_(clusters[a], clusters[b])].sum(axis=(0, 1))
                mean[a, b] = weighted / evidence
        (a, b), best = max(mean.items(), key=lambda item: item[1])
        if best < least:
            break
        clusters[b] += clusters.pop(a)
    return sorted(sorted(cluster) for cluster in clusters)


def fundamental_residuals(x, y, prior):
    """Squared Sampson distances under the reweighted, normalised eight-point method (Hartley 1997)."""
    (p, left), (q, right) = _normalised(x), _normalised(y)
    rows = np.einsum("ni,nj->nij", q, p).reshape(len(x), 9)
    weight = prior
    for _ in range(3):
        u, s, vt = np.linalg.svd(np.linalg.svd(rows * weight[:, None])[2][-1].reshape(3, 3))
        matrix = right.T @ (u * [s[0], s[1], 0] @ vt) @ left
        a, b = np.column_stack([x, np.ones(len(x))]), np.column_stack([y, np.ones(len(y))])
        error = np.einsum("ni,ij,nj->n", b, matrix, a) ** 2
        gradient = ((a @ matrix.T)[:, :2] ** 2).sum(1) + ((b @ matrix)[:, :2] ** 2).sum(1)
        square = error / gradient
        weight = prior / np.sqrt(1 + square / (4 * max(np.median(square), 0.01)))
    return square


def _normalised(x):
    scale = np.sqrt(2) / np.linalg.norm(x - x.mean(0), axis=1).mean()
    matrix = np.array([[scale, 0, -scale * x[:, 0].mean()], [0, scale, -scale * x[:, 1].mean()], [0, 0, 1]])
    return np.column_stack([x, np.ones(len(x))]) @ matrix.T, matrix


def residual_alone(x, y):
    moved = np.linalg.norm(y - x, axis=1)
    return np.median(fundamental_residuals(x, y, np.ones(len(x)))), np.median(moved)


def residuals_joint(xa, ya, xb, yb, residuals=fundamental_residuals):
    prior = np.repeat([len(xa) ** -0.5, len(xb) ** -0.5], [len(xa), len(xb)])
    square = residuals(np.concatenate([xa, xb]), np.concatenate([ya, yb]), prior)
    return np.median(square[: len(xa)]), np.median(square[len(xa) :])


def affine_residuals(x, y, prior):
    """Squared residuals [n] under a reweighted affine motion."""
    weight, square = prior, None
    for _ in range(4):
        rows = np.column_stack([x, np.ones(len(x))]) * np.sqrt(weight)[:, None]
        motion = np.linalg.lstsq(rows, (y - x) * np.sqrt(weight)[:, None], rcond=None)[0]
        square = ((y - x - np.column_stack([x, np.ones(len(x))]) @ motion) ** 2).sum(axis=1)
        weight = prior / np.sqrt(1 + square / (4 * max(np.median(square), 1e-4)))
    return square


def affine_residual_alone(x, y):
    return np.median(affine_residuals(x, y, np.ones(len(x))))


def affine_residuals_joint(xa, ya, xb, yb):
    return residuals_joint(xa, ya, xb, yb, affine_residuals)


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
