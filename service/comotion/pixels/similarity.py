"""Rates how likely it is that two trajectories belong to one body."""

import numpy as np

from ..arrays import Floats, Floats32, Ints
from .kernels.affine import local_residuals
from .key_frames import STEPS, KeyFrames, frame_pairs

# px² per member; regularisation of the affine motion of a group. px²; squared residual from which on it costs
# no more.
_RIDGE, _CAP = 25.0, 400.0

# Width of the preference kernel as a multiple of the typical best residual and of what noise adds to a
# residual, and px² added to it.
_MISFIT_FACTOR, _NOISE_FACTOR, _FLOOR = 32.0, 2.0, 0.05
# Squared displacement of a motion in the image per variance of a coordinate, less what the fit takes up.
_NOISE_OF_DISPLACEMENT = 3.6
# Singular vectors that span the shape interaction. Rank and iterations of the completion of unseen positions.
_RANK, _COMPLETION_RANK, _COMPLETION_ROUNDS = 8, 6, 40
# Added to the preference kernel of a pair and to its shape interaction: neither can veto a pair alone.
_PREFERENCE_FLOOR, _INTERACTION_FLOOR = 0.001, 0.01
# Products of smaller preferences are denormal, on which multiplication takes ten times as long.
_NEGLIGIBLE = 1e-6


def explain(frames: KeyFrames, members: Ints) -> Floats32:
    """Mean squared residuals of N trajectories under H local motions, [H, N] px²; inf where none applies.

    Parameters
    ----------
    frames
        Key frames of the trajectories: a motion is an affine field in each pair of them.
    members
        Of the local motions, intp [H, M].
    """
    first, second = frame_pairs(len(frames.positions), STEPS, len(frames.positions)).T
    seen = (frames.visible[first] & frames.visible[second]).astype(np.float32)
    start = frames.positions[first]
    masked = np.stack([start, frames.positions[second] - start]) * seen[..., None]
    start, displacement = np.ascontiguousarray(masked.transpose(0, 1, 3, 2))
    square, used = local_residuals(start, displacement, seen, members, _RIDGE, np.float32(_CAP))
    count = used.T @ seen
    square /= np.maximum(count, np.float32(1))
    square[count == 0] = np.inf
    return square


def preference(square: Floats32, variance: Floats32) -> Floats32:
    """Tanimoto kernel [N, N] of the motions that trajectories prefer.

    A trajectory prefers the local motions that explain it (J-linkage's preference sets, Toldo and Fusiello
    2008, with the Tanimoto distance of T-linkage, Magri and Fusiello 2014). The part of a residual that noise
    explains is taken away before: it is the same under all motions, and says nothing.

    Parameters
    ----------
    square
        float32 [H, N], px²; mean squared residuals, see :func:`explain`; used up.
    variance
        float32 [N], px²; noise of a coordinate.
    """
    noise = np.float32(_NOISE_OF_DISPLACEMENT) * variance
    square -= noise
    np.maximum(square, np.float32(0), out=square)
    # The least of all motions would be lower, and with it the width: it is that of each half of them.
    best = np.mean([square[k::2].min(axis=0) for k in range(2)], axis=0)
    typical = float(np.median(np.where(np.isfinite(best), best, 0)))
    width = _MISFIT_FACTOR * typical + _NOISE_FACTOR * float(np.median(noise)) + _FLOOR
    square *= np.float32(-1 / (2 * width))
    preferred = np.exp(square, out=square)
    preferred[preferred < _NEGLIGIBLE] = 0
    overlap = preferred.T @ preferred
    own = overlap.diagonal()
    return np.asarray(overlap / np.maximum(own[:, None] + own - overlap, np.float32(1e-12)))


def combine(kernel: Floats32, vectors: Floats32) -> Floats32:
    """Geometric mean of the preference kernel [N, N] and shape interaction |v_i·v_j|⁴.

    Parameters
    ----------
    kernel
        float32 [N, N].
    vectors
        float32 [D, N]; singular vectors of the trajectories, see :func:`subspace`.
    """
    unit = vectors / np.maximum(np.linalg.norm(vectors, axis=0), np.float32(1e-8))
    interaction = np.square(np.square(unit.T @ unit))
    similarity = (interaction + np.float32(_INTERACTION_FLOOR)) * (kernel + np.float32(_PREFERENCE_FLOOR))
    return np.asarray(np.sqrt(similarity, out=similarity))


def subspace(frames: KeyFrames) -> Floats32:
    """Right singular vectors of the completed trajectory matrix, float32 [D, N], D up to :data:`_RANK`.

    The matrix has 2F rows of x and y (shape interaction, Costeira and Kanade 1998).
    """
    matrix = _complete(frames)
    # Of its square, which is small: that takes a tenth of the time.
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    kept = np.flatnonzero(values > 1e-12 * values[-1])[: -_RANK - 1 : -1]
    return np.asarray((vectors[:, kept].T @ matrix / np.sqrt(values[kept])[:, None]).astype(np.float32))


def _complete(frames: KeyFrames) -> Floats:
    """Trajectory matrix [2F, N] with its unseen entries completed."""
    count, total = frames.visible.shape
    # At first unseen entries are as in the last frame before, or else in the next one.
    frame = np.maximum.accumulate(np.where(frames.visible, np.arange(count)[:, None], -1), axis=0)
    frame = np.where(frame < 0, frames.visible.argmax(axis=0), frame)
    filled = frames.positions[frame, np.arange(total)].astype(np.float64)
    matrix = filled.transpose(0, 2, 1).reshape(2 * count, total)
    basis = np.linalg.eigh(matrix @ matrix.T)[1][:, -_COMPLETION_RANK:]
    unseen = ~np.repeat(frames.visible, 2, axis=0)
    for _ in range(_COMPLETION_ROUNDS if unseen.any() else 0):
        # One step of orthogonal iteration follows the subspace: the matrix changes little per round.
        basis = np.linalg.qr(matrix @ (matrix.T @ basis))[0]
        np.copyto(matrix, basis @ (basis.T @ matrix), where=unseen)
    return matrix
