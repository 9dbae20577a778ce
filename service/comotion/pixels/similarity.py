"""Key frames in; how likely two trajectories belong to one body, and on what evidence, out."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import ssyrk

from ..arrays import Bools, Floats, Floats32, Ints
from .affine import Residuals
from .kernels.similarity import combine_kernels, mean_residuals, tanimoto, weigh_preferences
from .key_frames import KeyFrames

# Width of the preference kernel as a multiple of the typical best residual, and px² added to it.
_NOISE_FACTOR, _NOISE_FLOOR = 32.0, 0.05
# Power of the share of motion that a trajectory was seen in, in the evidence of a pair; and evidence of a
# pair that no local motion covers.
_COVERAGE_POWER, _EVIDENCE_FLOOR = 3, 0.0005
# Numbers of singular vectors that the shape interaction is averaged over: it depends on the rank, and no one
# rank is right for all scenes. Rank and iterations of the completion of unseen positions.
_RANKS, _COMPLETION_RANK, _COMPLETION_ROUNDS = (5, 6, 8, 10), 6, 40
# Added to the preference kernel of a pair, to its mean shape interaction, and to that at each rank, so that
# neither can veto a pair alone.
_FLOORS = 0.001, 0.01, 0.001
# Local motions per draw: the width of the preference kernel follows from the least residual in a draw.
_MOTIONS_PER_DRAW = 300
# Coverage is formed over every fourth motion: they differ little in where they can be fitted.
_COVERAGE_STEP = 4
_MULT, _C, _PER = .9, 2, False


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


class VisibilityPatterns(NamedTuple):
    """P different rows among M.

    Attributes
    ----------
    first
        intp [P]; the first row of each pattern.
    of
        intp [M]; the pattern of every row.
    """

    first: Ints
    of: Ints


def preference(residuals: Residuals, seen: Floats32, variance: Floats32) -> Similarity:
    """Tanimoto kernel of the motions that trajectories prefer, its evidence, and the best residuals.

    A trajectory prefers the local motions that explain it (J-linkage's preference sets, Toldo and Fusiello
    2008, with the Tanimoto distance of T-linkage, Magri and Fusiello 2014). The frame pairs that a motion
    covers follow from the visibility of either, and many share these: sums over coverage are formed once
    per pattern.

    Parameters
    ----------
    residuals
        Of H local motions and N trajectories; the total residuals are used up.
    seen
        float32 [Q, N]; 1 where a trajectory is seen in a frame pair.
    variance
        float32 [N], px²; noise of a coordinate. What it explains of a residual says nothing.
    """
    share = (residuals.activity / max(float(residuals.activity.sum()), 1e-12)).astype(np.float32)
    motion, track = visibility_patterns(residuals.used), visibility_patterns(seen.T)
    used = residuals.used[motion.first]
    coverage = (((used * share) @ seen) ** _COVERAGE_POWER).astype(np.float32)
    square = residuals.total
    mean_residuals(square, used @ seen, motion.of)
    noise = np.float32(_MULT * 4) * variance
    np.maximum(square - noise, np.float32(0), out=square)
    best = _best_residuals(square)
    known = np.isfinite(best)
    typical = float(np.median(best[known])) if known.any() else 0.0
    if _PER:
        square *= -1 / (2 * (np.float32(_NOISE_FACTOR * typical + _NOISE_FLOOR) + np.float32(_C) * noise))
    else:
        square *= np.float32(-1 / (2 * (_NOISE_FACTOR * typical + _NOISE_FLOOR + _C * float(np.median(noise)))))
    preferred = np.exp(square, out=square)
    own = weigh_preferences(preferred, coverage, motion.of)
    # Fortran's lower triangle is C's upper one, the only valid one; `tanimoto` reads no other.
    both = ssyrk(1.0, preferred.T, lower=1).T
    narrow = coverage[:, track.first]
    counts = np.bincount(motion.of[::_COVERAGE_STEP], minlength=len(used)).astype(np.float32)
    some = counts > 0
    covered = (narrow[some].T * (counts[some] / counts.sum())) @ narrow[some]
    evidence = np.empty_like(both)
    tanimoto(both, evidence, own.T @ narrow, covered, track.of, np.float32(_EVIDENCE_FLOOR))
    return Similarity(both, evidence, np.where(known, best, np.float32(np.nan)))


def combine(kernel: Similarity, vectors: Floats32) -> Similarity:
    """Geometric mean of the preference kernel and shape interaction, in place of the kernel's value.

    Parameters
    ----------
    kernel
        Preference kernel of N trajectories; its value is used up.
    vectors
        float32 [D, N]; singular vectors of the trajectories, see :func:`subspace`.
    """
    floors = (np.float32(floor) for floor in _FLOORS)
    combine_kernels(kernel.value, vectors, np.array(_RANKS), *floors)
    return kernel


def _best_residuals(square: Floats32) -> Floats32:
    """Expected least residual in a draw of motions, [N]: the mean of several draws' minima.

    The least of all motions would fall with their number, and with it the width of the kernel.
    """
    draws = max(1, round(len(square) / _MOTIONS_PER_DRAW))
    least = np.stack([square[k::draws].min(axis=0) for k in range(draws)])
    known = np.isfinite(least)
    total = np.where(known, least, np.float32(0)).sum(axis=0)
    mean: Floats32 = total / np.maximum(known.sum(axis=0, dtype=np.float32), 1)
    return np.where(known.any(axis=0), mean, np.float32(np.inf))


def visibility_patterns(rows: NDArray[Any]) -> VisibilityPatterns:
    """Patterns of M rows of ones and zeros, [M, Q]."""
    bits = np.packbits(rows > 0, axis=1)
    # A byte that all have in common: without columns there is still one pattern.
    keys = np.zeros((len(bits), bits.shape[1] + 1), np.uint8)
    keys[:, 1:] = bits
    _, first, of = np.unique(keys.view(f"V{keys.shape[1]}")[:, 0], return_index=True, return_inverse=True)
    return VisibilityPatterns(first, of)


def subspace(
    frames: KeyFrames,
    dimensions: int = max(_RANKS),
    rank: int = _COMPLETION_RANK,
    rounds: int = _COMPLETION_ROUNDS,
) -> Floats32:
    """Right singular vectors of the completed trajectory matrix, float32 [dimensions, N].

    The matrix has 2F rows of x and y (shape interaction, Costeira and Kanade 1998). Unseen entries are
    completed at `rank` by `rounds` of imputation. Rows beyond the matrix's rank are 0.
    """
    matrix = _complete(frames, rank, rounds)
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    values, vectors = values[::-1][:dimensions], vectors[:, ::-1][:, :dimensions]
    real = values > 1e-12 * max(float(values[0]), 1e-300)
    found = np.zeros((dimensions, matrix.shape[1]), np.float32)
    projected = vectors[:, real].T @ matrix / np.sqrt(values[real])[:, None]
    found[: len(projected)] = projected
    return found


def _complete(frames: KeyFrames, rank: int, rounds: int) -> Floats:
    """Trajectory matrix [2F, N] with its unseen entries completed, scaled to 1 at most."""
    count, total = frames.visible.shape
    seen = np.repeat(frames.visible, 2, axis=0)
    values = frames.positions.astype(np.float64).transpose(0, 2, 1).reshape(2 * count, total)
    values /= max(float(np.abs(values).max(initial=0.0)), 1e-9)
    if seen.all():
        return values
    matrix = np.where(seen, values, _last_seen(frames.visible, values))
    basis = np.linalg.eigh(matrix @ matrix.T)[1][:, -min(rank, 2 * count) :]
    gaps = ~frames.visible.all(axis=0)
    complete, rest, unseen = matrix[:, ~gaps], matrix[:, gaps], ~seen[:, gaps]
    moments = complete @ complete.T
    for _ in range(rounds):
        # One step of orthogonal iteration follows the subspace: the matrix changes little per round.
        basis = np.linalg.qr(moments @ basis + rest @ (rest.T @ basis))[0]
        np.copyto(rest, basis @ (basis.T @ rest), where=unseen)
    matrix[:, gaps] = rest
    return matrix


def _last_seen(visible: Bools, values: Floats) -> Floats:
    """Entries from the last frame that each trajectory was seen in, or the first to come."""
    count, total = visible.shape
    at = np.maximum.accumulate(np.where(visible, np.arange(count)[:, None], -1), axis=0)
    at = np.where(at < 0, visible.argmax(axis=0), at)
    by_frame = values.reshape(count, 2, total)
    return np.take_along_axis(by_frame, at[:, None], axis=0).reshape(2 * count, total)
