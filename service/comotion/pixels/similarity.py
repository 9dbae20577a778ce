"""How likely two trajectories belong to one body, and on what evidence (METHOD-pixels steps 3, 4)."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import ssyrk

from ..compiled import compiled
from .interaction import subspace
from .keyframes import Floats32, KeyFrames, frame_pairs
from .local import Residuals, explain
from .parameters import PixelParameters
from .sampling import sample_members

# Side of the blocks in which a matrix and its transpose are visited: both fit the cache.
_TILE = 64
_NEGLIGIBLE = 1e-6
_BLOCK = 300
# Motions differ little in where they can be fitted, so that some of them tell coverage.
_COVERAGE_STEP = 4


@dataclass(frozen=True)
class Similarity:
    """Similarity of N trajectories.

    Attributes
    ----------
    value, evidence
        float32 [N, N]: similarity 0..1 and the weight it counts with, both symmetric.
    residual
        float32 [N], px²; mean squared residual under the best local motion, NaN where none applies.
    """

    value: Floats32
    evidence: Floats32
    residual: Floats32


def compare(frames: KeyFrames, parameters: PixelParameters, rng: np.random.Generator) -> Similarity:
    """Compare N ≥ 2 trajectories with one another.

    The preference kernel says whether the same local motions explain two trajectories; shape
    interaction, whether they lie in one motion subspace. A pair must convince both.
    """
    p = parameters
    pairs = frame_pairs(frames, p.steps)
    groups = sample_members(frames, p.local_motions, p.members, p.reaches, p.motion_weight, rng)
    residuals = explain(pairs, groups, p.ridge, p.cap)
    preference, evidence, best = _preference(residuals, pairs.seen, p)
    vectors = subspace(frames, max(p.ranks), p.completion_rank, p.completion_rounds)
    floors = (p.preference_floor, p.interaction_floor, p.rank_floor)
    value = _combine(preference, vectors, np.array(p.ranks), *(np.float32(f) for f in floors))
    return Similarity(value, evidence, best)


def _preference(
    residuals: Residuals, seen: Floats32, p: PixelParameters
) -> tuple[Floats32, Floats32, Floats32]:
    """Tanimoto kernel of the motions that trajectories prefer, its evidence, and the best residuals."""
    count = residuals.used @ seen
    share = (residuals.activity / max(float(residuals.activity.sum()), 1e-12)).astype(np.float32)
    coverage = (((residuals.used * share) @ seen) ** p.coverage_power).astype(np.float32)
    square = np.where(count > 0, residuals.total / np.maximum(count, 1), np.float32(np.inf))
    best = _best(square)
    known = np.isfinite(best)
    typical = float(np.median(best[known])) if known.any() else 0.0
    width = 2 * (p.noise_factor * typical + p.noise_floor)
    preferred = np.exp(-square / np.float32(width))
    # Products of such small numbers are denormal, on which multiplication takes ten times as long.
    preferred[preferred < _NEGLIGIBLE] = 0
    weighted = coverage * preferred
    # Fortran's lower triangles are C's upper ones, the only valid ones; _tanimoto reads no other.
    both = ssyrk(1.0, weighted.T, lower=1).T
    some = coverage[::_COVERAGE_STEP]
    covered = ssyrk(1.0 / len(some), some.T, lower=1).T
    one_sided: Floats32 = (weighted * preferred).T @ coverage
    _tanimoto(both, covered, one_sided, np.float32(p.evidence_floor))
    return both, covered, np.where(known, best, np.float32(np.nan))


def _best(square: Floats32) -> Floats32:
    """Expected least residual under `_BLOCK` motions, [N]: the mean of several draws' minima.

    The least of all motions would fall with their number, and with it the width of the kernel.
    """
    blocks = max(1, round(len(square) / _BLOCK))
    least = np.stack([square[k::blocks].min(axis=0) for k in range(blocks)])
    known = np.isfinite(least)
    total = np.where(known, least, np.float32(0)).sum(axis=0)
    mean: Floats32 = total / np.maximum(known.sum(axis=0, dtype=np.float32), 1)
    return np.where(known.any(axis=0), mean, np.float32(np.inf))


@compiled(fastmath=True)
def _tanimoto(both: Floats32, covered: Floats32, one_sided: Floats32, floor: np.float32) -> None:
    """In place, from upper triangles: Σab / (Σa² + Σb² − Σab) and evidence, made symmetric."""
    tiny = np.float32(1e-12)
    count = len(both)
    for top in range(0, count, _TILE):
        for left in range(top, count, _TILE):
            for i in range(top, min(top + _TILE, count)):
                for j in range(max(i, left), min(left + _TILE, count)):
                    value = both[i, j] / max(one_sided[i, j] + one_sided[j, i] - both[i, j], tiny)
                    both[i, j] = both[j, i] = value
                    evidence = covered[i, j] + floor
                    covered[i, j] = covered[j, i] = evidence


@compiled()
def _combine(
    preference: Floats32,
    vectors: Floats32,
    ranks: np.ndarray[tuple[int], np.dtype[np.intp]],
    preference_floor: np.float32,
    interaction_floor: np.float32,
    rank_floor: np.float32,
) -> Floats32:
    """Geometric mean of preference and shape interaction, the latter a geometric mean over ranks.

    Rows of V are normalised per rank; interaction at a rank is |v_i·v_j|⁴. Every product is grouped
    so that (i, j) and (j, i) agree to the last bit, which linkage relies on.
    """
    dims, count = vectors.shape
    square = np.zeros((dims + 1, count), np.float32)
    for k in range(dims):
        square[k + 1] = square[k] + vectors[k] * vectors[k]
    # A row may be 0 (a feature at the origin); the product of two of these must stay finite.
    inverse = 1 / np.maximum(square, np.float32(1e-16))
    out = np.empty((count, count), np.float32)
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
                    cosine = (dot[j] * dot[j]) * (inverse[k + 1, i] * inverse[k + 1, j])
                    product[j] *= cosine * cosine + rank_floor
        for j in range(count):
            mean = (np.sqrt(np.sqrt(product[j])) if four else product[j] ** root) + interaction_floor
            out[i, j] = np.sqrt((preference[i, j] + preference_floor) * mean)
    return out
