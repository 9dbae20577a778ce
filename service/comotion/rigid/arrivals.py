"""Leaves newborn features unlabelled while they may be the return of a lost body (after step 9)."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Ints, last_true
from ..partition import NO_HYPOTHESIS
from .assignment import OUTLIER
from .subset import Scene

# Neighbours of a newborn feature that are examined, and how many of them must be newborn too.
_NEIGHBOURS, _LEAST_NEWBORN = 4, 2
# A hypothesis may return if it loses most of its features at once. In this order: s that count as at once;
# fewest features lost; their least share of all lost in the look-back; s of the look-back.
_AT_ONCE, _LEAST_LOST, _LOST_SHARE, _LOOK_BACK = 0.08, 3, 0.6, 0.55


def undecided(scene: Scene, labels: Ints) -> Ints:
    """The labels, intp [N], but :data:`OUTLIER` for features that may be a lost body's return.

    By place alone, the features of a body that returns would be those of the bodies about it, and of the
    static one, which has members everywhere. So while a hypothesis has no features, after it lost most of
    them at once, features that appear later among other newborn ones are outliers until their motion is
    known. Those that appear as soon as it loses them are the same ones, under other names.
    """
    frames = scene.frames
    newborn = frames.current & ~scene.judged & (scene.hypotheses == NO_HYPOTHESIS)
    doubtful = newborn & (labels != OUTLIER)
    if np.count_nonzero(newborn) <= _LEAST_NEWBORN or not doubtful.any():
        return labels
    born = frames.stamps[-1] - (frames.life * 1e9).astype(np.int64)
    doubtful &= born > _first_loss(scene) + _AT_ONCE * 1e9
    if not doubtful.any():
        return labels
    current = np.flatnonzero(frames.current)
    neighbours = min(_NEIGHBOURS + 1, len(current))
    nearest = cKDTree(scene.newest[current]).query(scene.newest[doubtful], neighbours)[1]
    # The nearest neighbour of each feature is the feature itself.
    crowd = newborn[current][nearest].sum(1) - 1 >= _LEAST_NEWBORN
    decided = labels.copy()
    decided[np.flatnonzero(doubtful)[crowd]] = OUTLIER
    return decided


def _first_loss(scene: Scene) -> float:
    """When the first of the hypotheses without a feature lost most of them at once, ns; infinite for none."""
    frames, first_loss = scene.frames, np.inf
    gone = np.setdiff1d(scene.hypotheses[~frames.current], scene.hypotheses[frames.current]).tolist()
    rows, first = np.unique(frames.owner, return_index=True)
    for hypothesis in gone:
        members = rows[~frames.current[rows] & (scene.hypotheses[rows] == hypothesis)]
        if hypothesis == NO_HYPOTHESIS or len(members) < _LEAST_LOST:
            continue
        w = frames.w[first[np.searchsorted(rows, members)]]
        last = frames.stamps[last_true(w > 0)]
        seconds_before = (last.max() - last) * 1e-9
        at_once = np.count_nonzero(seconds_before <= _AT_ONCE)
        if at_once >= max(_LEAST_LOST, _LOST_SHARE * np.count_nonzero(seconds_before <= _LOOK_BACK)):
            first_loss = min(first_loss, int(last.max()))
    return first_loss
