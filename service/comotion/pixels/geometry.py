"""Compares groups over wide baselines: whether they are two bodies.

One fundamental matrix per frame pair explains the parts of one rigid body, near and far, to within the noise.
Two bodies, as a rule, do not share one.
"""

import numpy as np

from ..arrays import Floats, Ints, median
from .kernels.epipolar import fundamental, sampson
from .key_frames import KeyFrames, evenly_spaced, frame_pairs

# Members that represent a group in a frame pair; fewer than the least are not compared.
_POINTS, _LEAST_MEMBERS = 50, 12
# Fewer key frames show no wide baseline. Wide pairs are half of the key frames apart; one more is of the
# first and the last.
_LEAST_FRAMES, _WIDE_PAIRS = 13, 3
# Parameters of a fundamental matrix: so many points are fitted by chance.
_PARAMETERS = 7
# Median of a squared standard normal deviate; px² that are added to a typical squared distance.
_CHI2_MEDIAN_1D, _LEAST_PX2 = 0.455, 1e-6
# Share of a motion by which features drift or a lens distorts it.
_DRIFT = 0.02
# nat; log ratio of two groups' joint residual to noise and drift, above which they are two bodies.
_CONTRADICTION = 0.8


def two_bodies(frames: KeyFrames, first: Ints, second: Ints) -> bool:
    """Whether no fundamental matrix explains two groups together to within noise and drift.

    Parameters
    ----------
    frames
        Key frames of all trajectories.
    first, second
        intp, indices of trajectories.
    """
    excess, count = [], len(frames.positions)
    if count < _LEAST_FRAMES:
        return False
    for pair in frame_pairs(count, (count // 2, count - 1), _WIDE_PAIRS):
        views = [_view(frames, group, pair) for group in (first, second)]
        large = [(view, _expected(view)) for view in views if view.shape[1] >= _LEAST_MEMBERS]
        if len(large) == len(views):
            joint = fundamental(*np.concatenate(views, axis=1))
            ratios = [median(sampson(joint, *view)) / expected for view, expected in large]
            excess.append(max(*ratios, 1e-12))
    return bool(excess) and bool(0.5 * np.log(excess).mean() > _CONTRADICTION)


def _view(frames: KeyFrames, group: Ints, pair: Ints) -> Floats:
    """Points of a group that are seen in a pair of frames, float64 [2, n, 2]."""
    members = group[frames.visible[np.ix_(pair, group)].all(axis=0)]
    chosen = members[evenly_spaced(len(members), _POINTS)]
    return frames.positions[np.ix_(pair, chosen)].astype(np.float64)


def _expected(view: Floats) -> float:
    """Typical squared distance of points [2, n, 2] of one body under a matrix of several, px²."""
    start, end = view
    square = median(sampson(fundamental(start, end), start, end)) * len(start) / (len(start) - _PARAMETERS)
    drifted = _DRIFT * median(np.linalg.norm(end - start, axis=1))
    return float(square + _CHI2_MEDIAN_1D * drifted**2 + _LEAST_PX2)
