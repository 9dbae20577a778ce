"""Rates whether groups of trajectories prefer the same epipolar geometries.

Many fundamental matrices are fitted to few points each, in pairs of key frames near and far apart. Parts of
one body rank them alike, however much noise there is: ranks need no scale (ordered residual kernel, Chin,
Wang and Suter 2009; for motion segmentation Xu, Cheong and Li 2018).
"""

import numpy as np

from ..arrays import Floats, Ints, inverses
from .key_frames import STEPS, KeyFrames, evenly_spaced, frame_pairs

# Frame pairs of each length; geometries that are drawn in each, from so many points.
_PAIRS, _DRAWN, _PICKED = 4, 100, 12
# Members of a group that are looked at, and that a frame pair must show.
_MEMBERS, _LEAST_MEMBERS = 40, 3
# Share of the geometries within which a rank counts: its weight is exp(-rank / share).
_SHARE = 0.2
# What is added to the diagonal of a normal matrix of size 1, and rounds of inverse iteration.
_RIDGE, _ROUNDS = 1e-12, 8


def consensus(frames: KeyFrames, groups: list[Ints], rng: np.random.Generator) -> Floats:
    """Correlation of the ranks that groups give to epipolar geometries, [G, G]; 0 where not known.

    Parameters
    ----------
    frames
        F key frames of N trajectories.
    groups
        intp, indices of trajectories.
    rng
        Source of the draws.
    """
    total, count = np.zeros((2, len(groups), len(groups)))
    steps = *STEPS, len(frames.positions) // 2
    for first, second in frame_pairs(len(frames.positions), steps, _PAIRS).tolist():
        seen = frames.visible[first] & frames.visible[second]
        members = [group[seen[group]] for group in groups]
        shown = np.array([k for k in range(len(groups)) if len(members[k]) >= _LEAST_MEMBERS], np.intp)
        if len(shown) < 2:
            continue
        picked = [members[k][evenly_spaced(len(members[k]), _MEMBERS)] for k in shown]
        starts = np.concatenate([[0], np.cumsum([len(part) for part in picked])])
        start, end = frames.positions[np.ix_([first, second], np.concatenate(picked))].astype(np.float64)
        picks = _draw(starts, rng)
        squares = _sampson(_fundamental(start[picks], end[picks]), start, end)
        misfits = np.add.reduceat(squares, starts[:-1], axis=1) / np.diff(starts)
        ranks = misfits.argsort(axis=0).argsort(axis=0)
        rated = np.exp(-ranks / (_SHARE * _DRAWN))
        rated -= rated.mean(axis=0)
        # 0 where all are alike: their order would agree with that of any other such group.
        rated /= np.where(np.ptp(misfits, axis=0) > 0, np.linalg.norm(rated, axis=0), np.inf)
        rows = np.ix_(shown, shown)
        total[rows] += rated.T @ rated
        count[rows] += 1
    return np.asarray(total / np.maximum(count, 1))


def _draw(starts: Ints, rng: np.random.Generator) -> Ints:
    """Points of each geometry, intp [H, m]: spread over a group and another one, which may be the same."""
    size = np.diff(starts)
    weight = np.sqrt(size)
    first = rng.choice(len(size), _DRAWN, p=weight / weight.sum())
    second = rng.integers(len(size), size=_DRAWN)
    total = size[first] + np.where(first == second, 0, size[second])
    place = (np.arange(_PICKED) + rng.random((_DRAWN, _PICKED))) / _PICKED
    index = (place * total[:, None]).astype(np.intp)
    beyond = index - size[first, None]
    return np.asarray(np.where(beyond < 0, starts[first, None] + index, starts[second, None] + beyond))


def _fundamental(first: Floats, second: Floats) -> Floats:
    """Fundamental matrices [H, 3, 3] of points [H, m, 2] in two frames, by eight points (Hartley 1997)."""
    (x, left), (u, right) = _normalised(first), _normalised(second)
    full = _least((u[..., None] * x[..., None, :]).reshape(*x.shape[:2], 9)).reshape(-1, 3, 3)
    # Its rank is 2.
    null = _least(full)[..., None]
    return np.asarray(right.mT @ (full - full @ null @ null.mT) @ left)


def _least(rows: Floats) -> Floats:
    """Unit vectors [H, n] that rows [H, m, n] multiply to the least, by inverse iteration."""
    inverse = inverses(rows.mT @ rows + _RIDGE * np.eye(rows.shape[2]))
    vectors = np.linalg.matrix_power(inverse, _ROUNDS).sum(axis=2)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _normalised(points: Floats) -> tuple[Floats, Floats]:
    """Points [H, m, 2] as homogeneous ones at a distance of √2 from 0, and the matrices of that [H, 3, 3]."""
    centre = points.mean(axis=1, keepdims=True)
    scale = 1 / np.maximum((points - centre).std(axis=(1, 2), keepdims=True), 1e-9)
    matrix = scale * np.eye(3)
    matrix[:, :2, 2], matrix[:, 2, 2] = -(scale * centre)[:, 0], 1
    return np.insert((points - centre) * scale, 2, 1.0, axis=2), matrix


def _sampson(matrices: Floats, first: Floats, second: Floats) -> Floats:
    """Squared Sampson distances, px² [H, n], of points [n, 2] in two frames under fundamental matrices."""
    x, u = np.insert(first, 2, 1.0, axis=1), np.insert(second, 2, 1.0, axis=1)
    left, across, right = ((a[..., None] * b[:, None]).reshape(-1, 9).T for a, b in ((x, x), (u, x), (u, u)))
    slope = (matrices[:, :2].mT @ matrices[:, :2]).reshape(-1, 9) @ left
    slope += (matrices[..., :2] @ matrices.mT[:, :2]).reshape(-1, 9) @ right
    return np.asarray((matrices.reshape(-1, 9) @ across) ** 2 / np.maximum(slope, 1e-12))
