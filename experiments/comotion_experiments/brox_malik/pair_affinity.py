"""The affinity of Brox and Malik, from positions over frames.

Brox and Malik (2010), "Object segmentation by long term analysis of point trajectories":

    d_t(A, B)² = d_sp(A, B) |m_t(A) - m_t(B)|² / (5 σ_t²)      (3)
    d(A, B)²   = max over the common time of d_t²              (2)
    w(A, B)    = exp(-λ d²), λ = 0.1                           (1)

m_t is the motion over five frames, d_sp the mean distance in the image over the common time, and σ_t the
local variation of the flow. We have trajectories and no flow field: σ_t² is the variance of the motion
among a trajectory's nearest neighbours, the smaller one of the pair, and not below the noise.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]

STEP = 5
"""Frames over which motion is measured."""
LAMBDA = 0.1
NEIGHBOURS = 8
# λ is for distances in pixels. In metres the scene is scaled to so many units, which was best for the
# comparator among 500, 100, 30, 10 and 3, on seed 0 of fig. 4.1 and 4.4, 3d_3 and 3d_outliers.
_EXTENT = 3.0
_LEAST_NOISE = 1e-9


def affinity(positions: Floats, *, pixels: bool) -> Floats:
    """Affinity of every pair of trajectories, float64 [N, N] in 0..1; 0 without common motion.

    Parameters
    ----------
    positions
        float64 [F, N, dim], NaN where unobserved.
    pixels
        Whether they are in pixels. Else lengths are scaled to a fixed width of the scene.
    """
    scale = 1.0 if pixels else _EXTENT / max(_extent(positions), _LEAST_NOISE)
    x = positions * scale
    count = x.shape[1]
    motion = x[STEP:] - x[:-STEP]
    floor = 2 * _noise(x) ** 2
    largest = np.full((count, count), -1.0)
    distance, common = np.zeros((count, count)), np.zeros((count, count))
    for t in range(len(motion)):
        rows = np.flatnonzero(np.isfinite(motion[t]).all(axis=1))
        if len(rows) < 2:
            continue
        m, at = motion[t, rows], x[t, rows]
        variation = np.maximum(_variation(m, at), floor)
        difference = ((m[:, None] - m[None]) ** 2).sum(2) / (
            STEP * np.minimum(variation[:, None], variation[None])
        )
        cell = np.ix_(rows, rows)
        largest[cell] = np.maximum(largest[cell], difference)
        distance[cell] += np.linalg.norm(at[:, None] - at[None], axis=2)
        common[cell] += 1
    squared = distance / np.maximum(common, 1) * largest
    affinity = np.where(common > 0, np.exp(-LAMBDA * squared), 0.0)
    np.fill_diagonal(affinity, 1.0)
    return affinity


def _variation(motion: Floats, at: Floats) -> Floats:
    """Variance of a coordinate of the motion among the nearest neighbours of each trajectory, [n]."""
    near = min(NEIGHBOURS + 1, len(at))
    _, rows = cKDTree(at).query(at, k=near)
    return np.asarray(motion[rows.reshape(len(at), near)].var(axis=1).mean(axis=1), np.float64)


def _noise(x: Floats) -> float:
    """One-sigma noise of a coordinate: third differences of smooth motion are noise alone."""
    third = np.diff(x, n=3, axis=0)
    known = third[np.isfinite(third)]
    # The variance of third differences is 20 times that of the noise.
    return float(np.median(np.abs(known)) / 0.6745 / np.sqrt(20)) if len(known) else _LEAST_NOISE


def _extent(positions: Floats) -> float:
    known = positions[np.isfinite(positions).all(axis=2)]
    return float((known.max(0) - known.min(0)).max()) if len(known) else 1.0
