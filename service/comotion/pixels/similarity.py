"""How likely two trajectories belong to one body, and on what evidence (METHOD-pixels steps 3, 4)."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import ssyrk

from ..compiled import compiled
from ..config import PixelsConfig
from .interaction import subspace
from .keyframes import Floats32, KeyFrames, frame_pairs
from .local import Residuals, explain
from .patterns import alike
from .sampling import Indices, sample_members

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


def compare(frames: KeyFrames, parameters: PixelsConfig, rng: np.random.Generator) -> Similarity:
    """Compare N ≥ 2 trajectories with one another.

    The preference kernel says whether the same local motions explain two trajectories; shape
    interaction, whether they lie in one motion subspace. A pair must convince both.
    """
    p = parameters
    pairs = frame_pairs(frames, p.steps)
    groups = sample_members(frames, p.local_motions, p.members, p.reaches, p.motion_weight, rng)
    residuals = explain(pairs, groups, p.ridge, p.cap)
    value, evidence, best = preference(residuals, pairs.seen, p)
    vectors = subspace(frames, max(p.ranks), p.completion_rank, p.completion_rounds)
    floors = (p.preference_floor, p.interaction_floor, p.rank_floor)
    _combine(value, vectors, np.array(p.ranks), *(np.float32(f) for f in floors))
    return Similarity(value, evidence, best)


def preference(residuals: Residuals, seen: Floats32, p: PixelsConfig) -> tuple[Floats32, Floats32, Floats32]:
    """Tanimoto kernel of the motions that trajectories prefer, its evidence, and the best residuals.

    What a motion covers of a trajectory follows from the frame pairs of either, and many share these:
    sums over coverage are formed once per pattern. The total residuals are used up.
    """
    share = (residuals.activity / max(float(residuals.activity.sum()), 1e-12)).astype(np.float32)
    motion, track = alike(residuals.used), alike(seen.T)
    used = residuals.used[motion.first]
    coverage = (((used * share) @ seen) ** p.coverage_power).astype(np.float32)
    square = residuals.total
    _mean(square, used @ seen, motion.of)
    best = _best(square)
    known = np.isfinite(best)
    typical = float(np.median(best[known])) if known.any() else 0.0
    square *= np.float32(-1 / (2 * (p.noise_factor * typical + p.noise_floor)))
    preferred = np.exp(square, out=square)
    own = _weigh(preferred, coverage, motion.of)
    # Fortran's lower triangle is C's upper one, the only valid one; _tanimoto reads no other.
    both = ssyrk(1.0, preferred.T, lower=1).T
    narrow = coverage[:, track.first]
    counts = np.bincount(motion.of[::_COVERAGE_STEP], minlength=len(used)).astype(np.float32)
    some = counts > 0
    covered = (narrow[some].T * (counts[some] / counts.sum())) @ narrow[some]
    evidence = np.empty_like(both)
    _tanimoto(both, evidence, own.T @ narrow, covered, track.of, np.float32(p.evidence_floor))
    return both, evidence, np.where(known, best, np.float32(np.nan))


@compiled()
def _mean(total: Floats32, count: Floats32, motion: Indices) -> None:
    """Divide sums [H, N] by the counts [G, N] of their motions' patterns, in place; infinite without any."""
    for h in range(len(total)):
        n = count[motion[h]]
        for i in range(len(n)):
            total[h, i] = total[h, i] / n[i] if n[i] > 0 else np.float32(np.inf)


@compiled()
def _weigh(preferred: Floats32, coverage: Floats32, motion: Indices) -> Floats32:
    """Weight preferences [H, N] by coverage [G, N] in place; sums of weighted squares by pattern [G, N]."""
    squares = np.zeros_like(coverage)
    for h in range(len(preferred)):
        c, total = coverage[motion[h]], squares[motion[h]]
        for i in range(len(c)):
            # Products of such small numbers are denormal, on which multiplication takes ten times as long.
            value = preferred[h, i] if preferred[h, i] >= _NEGLIGIBLE else np.float32(0)
            preferred[h, i] = c[i] * value
            total[i] += c[i] * value * value
    return squares


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
def _tanimoto(
    both: Floats32, evidence: Floats32, own: Floats32, covered: Floats32, track: Indices, floor: np.float32
) -> None:
    """Σab / (Σa² + Σb² − Σab) in place of the upper triangle of Σab, and evidence; both made symmetric.

    Σa² [N, P] and evidence [P, P] are by pattern (intp [N]) of the other trajectory.
    """
    tiny = np.float32(1e-12)
    count = len(both)
    for top in range(0, count, _TILE):
        for left in range(top, count, _TILE):
            for i in range(top, min(top + _TILE, count)):
                p = track[i]
                for j in range(max(i, left), min(left + _TILE, count)):
                    value = both[i, j] / max(own[i, track[j]] + own[j, p] - both[i, j], tiny)
                    both[i, j] = both[j, i] = value
                    evidence[i, j] = evidence[j, i] = covered[p, track[j]] + floor


@compiled()
def _combine(
    preference: Floats32,
    vectors: Floats32,
    ranks: np.ndarray[tuple[int], np.dtype[np.intp]],
    preference_floor: np.float32,
    interaction_floor: np.float32,
    rank_floor: np.float32,
) -> None:
    """Geometric mean of preference and shape interaction, the latter a geometric mean over ranks.

    It takes the preference's place. Rows of V are normalised per rank; interaction at a rank is
    |v_i·v_j|⁴. Every product is grouped so that (i, j) and (j, i) agree to the last bit, which linkage
    relies on.
    """
    dims, count = vectors.shape
    square = np.zeros((dims + 1, count), np.float32)
    for k in range(dims):
        square[k + 1] = square[k] + vectors[k] * vectors[k]
    # A row may be 0 (a feature at the origin); the product of two of these must stay finite.
    inverse = 1 / np.maximum(square, np.float32(1e-16))
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
            preference[i, j] = np.sqrt((preference[i, j] + preference_floor) * mean)
