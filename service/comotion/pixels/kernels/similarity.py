"""Residuals of local motions and singular vectors in; similarities of all pairs of trajectories out."""

import numpy as np

from ...arrays import Floats32, Ints
from ...compiled import compiled

# Side of the blocks in which a matrix and its transpose are visited: both fit the cache.
_TILE = 64
# Products of smaller preferences are denormal, on which multiplication takes ten times as long.
_NEGLIGIBLE = 1e-6


@compiled()
def mean_residuals(total: Floats32, count: Floats32, pattern: Ints) -> None:
    """Divide sums [H, N] by the counts [P, N] of their motions' patterns [H], in place; inf without any."""
    for h in range(len(total)):
        n = count[pattern[h]]
        for i in range(len(n)):
            total[h, i] = total[h, i] / n[i] if n[i] > 0 else np.float32(np.inf)


@compiled()
def weigh_preferences(preferred: Floats32, coverage: Floats32, pattern: Ints) -> Floats32:
    """Weight preferences [H, N] by coverage [P, N] in place.

    Returns the sums [P, N] of weighted squares over the motions of each pattern.
    """
    squares = np.zeros_like(coverage)
    for h in range(len(preferred)):
        c, total = coverage[pattern[h]], squares[pattern[h]]
        for i in range(len(c)):
            value = preferred[h, i] if preferred[h, i] >= _NEGLIGIBLE else np.float32(0)
            preferred[h, i] = c[i] * value
            total[i] += c[i] * value * value
    return squares


@compiled()
def tanimoto(
    both: Floats32, evidence: Floats32, own: Floats32, covered: Floats32, pattern: Ints, floor: np.float32
) -> None:
    """Σab / (Σa² + Σb² − Σab) in place of the upper triangle of Σab, and evidence; both made symmetric.

    Σa² [N, P] and evidence [P, P] are by pattern (intp [N]) of the other trajectory.
    """
    tiny = np.float32(1e-12)
    count = len(both)
    for top in range(0, count, _TILE):
        for left in range(top, count, _TILE):
            for i in range(top, min(top + _TILE, count)):
                p = pattern[i]
                for j in range(max(i, left), min(left + _TILE, count)):
                    value = both[i, j] / max(own[i, pattern[j]] + own[j, p] - both[i, j], tiny)
                    both[i, j] = both[j, i] = value
                    evidence[i, j] = evidence[j, i] = covered[p, pattern[j]] + floor


@compiled()
def combine_kernels(
    preference: Floats32,
    vectors: Floats32,
    ranks: Ints,
    preference_floor: np.float32,
    interaction_floor: np.float32,
    rank_floor: np.float32,
) -> None:
    """Geometric mean of preference and shape interaction, in place of the preference [N, N].

    Shape interaction is a geometric mean over ranks of |v_i·v_j|⁴, where the singular vectors [D, N] are
    cut off at a rank and normalised. Every product is grouped so that (i, j) and (j, i) agree to the last
    bit, which linkage relies on.
    """
    dims, count = vectors.shape
    inverse = _inverse_squares(vectors)
    wanted = np.zeros(dims, np.bool_)
    wanted[ranks - 1] = True
    root = np.float32(1 / len(ranks))
    # A power costs ten times as much as two square roots.
    four = len(ranks) == 4
    dot = np.empty(count, np.float32)
    product = np.empty(count, np.float32)
    for i in range(count):
        dot[:] = 0
        product[:] = 1
        for k in range(dims):
            scale = vectors[k, i]
            for j in range(count):
                dot[j] += scale * vectors[k, j]
            if wanted[k]:
                for j in range(count):
                    cosine = (dot[j] * dot[j]) * (inverse[k, i] * inverse[k, j])
                    product[j] *= cosine * cosine + rank_floor
        for j in range(count):
            mean = (np.sqrt(np.sqrt(product[j])) if four else product[j] ** root) + interaction_floor
            preference[i, j] = np.sqrt((preference[i, j] + preference_floor) * mean)


@compiled()
def _inverse_squares(vectors: Floats32) -> Floats32:
    """1 / |v|² of the columns cut off after each row, [D, N]."""
    inverse = np.zeros(vectors.shape, np.float32)
    square = np.zeros(vectors.shape[1], np.float32)
    for k in range(len(vectors)):
        square += vectors[k] * vectors[k]
        # A column may be 0 (a feature at the origin); the product of two of these must stay finite.
        inverse[k] = 1 / np.maximum(square, np.float32(1e-16))
    return inverse
