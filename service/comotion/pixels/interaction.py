"""Shape interaction: trajectories of one rigid body span one subspace (METHOD-pixels step 4)."""

import numpy as np
from numpy.typing import NDArray

from .keyframes import Floats32, KeyFrames


def subspace(frames: KeyFrames, dimensions: int, rank: int, rounds: int) -> Floats32:
    """Right singular vectors of the completed trajectory matrix, float32 [dimensions, N].

    The matrix has 2F rows of x and y (Costeira and Kanade 1998). Unseen entries are completed at
    `rank` by `rounds` of imputation. Rows beyond the matrix's rank are 0.
    """
    matrix = _complete(frames, rank, rounds)
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    values, vectors = values[::-1][:dimensions], vectors[:, ::-1][:, :dimensions]
    real = values > 1e-12 * max(float(values[0]), 1e-300)
    found = np.zeros((dimensions, matrix.shape[1]), np.float32)
    projected = vectors[:, real].T @ matrix / np.sqrt(values[real])[:, None]
    found[: len(projected)] = projected
    return found


def _complete(frames: KeyFrames, rank: int, rounds: int) -> NDArray[np.float64]:
    count, total = frames.visible.shape
    seen = np.repeat(frames.visible, 2, axis=0)
    values = frames.positions.astype(np.float64).transpose(0, 2, 1).reshape(2 * count, total)
    values /= max(float(np.abs(values).max(initial=0.0)), 1e-9)
    if seen.all():
        return values
    matrix = np.where(seen, values, _held(frames.visible, values))
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


def _held(visible: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Entries from the last frame that each trajectory was seen in, or the first to come."""
    count, total = visible.shape
    at = np.maximum.accumulate(np.where(visible, np.arange(count)[:, None], -1), axis=0)
    at = np.where(at < 0, visible.argmax(axis=0), at)
    by_frame = values.reshape(count, 2, total)
    return np.take_along_axis(by_frame, at[:, None], axis=0).reshape(2 * count, total)
