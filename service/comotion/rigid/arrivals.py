"""In a scene and its labels, out the newborn of which place tells nothing (after step 9)."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Ints, last_true
from ..partition import NO_HYPOTHESIS
from .assignment import OUTLIER
from .subset import Scene

# Neighbours that are asked, and how many of them must be newborn too.
_ASKED, _NEWBORN = 4, 2
# Features that a hypothesis loses within so many s, at least, so that it may return: so many, and so large a
# share of those that it had so many s before.
_AT_ONCE, _LEAST_LOST, _MOST_OF, _BEFORE = 0.08, 3, 0.6, 0.55


def undecided(scene: Scene, labels: Ints) -> Ints:
    """The labels, intp [N], but :data:`OUTLIER` for features that may be a lost body's return.

    By place alone, the features of a body that returns would be those of the bodies about it, and of the
    static one, which is at home everywhere. So while a hypothesis is without features, most of which it has
    lost at once, what appears amid other newborn features belongs to nobody until its motion is known.
    """
    frames = scene.frames
    newborn = frames.current & ~scene.judged & (scene.before == NO_HYPOTHESIS)
    doubtful = newborn & (labels != OUTLIER)
    if np.count_nonzero(newborn) <= _NEWBORN or not doubtful.any() or not _any_lost(scene):
        return labels
    current = np.flatnonzero(frames.current)
    asked = min(_ASKED + 1, len(current))
    near = cKDTree(scene.newest[current]).query(scene.newest[doubtful], asked)[1]
    # Each finds itself as well.
    crowd = newborn[current][near].sum(1) - 1 >= _NEWBORN
    found = labels.copy()
    found[np.flatnonzero(doubtful)[crowd]] = OUTLIER
    return found


def _any_lost(scene: Scene) -> bool:
    """Whether a hypothesis has no feature that goes on, since it lost most of them at once."""
    frames = scene.frames
    gone = np.setdiff1d(scene.before[~frames.current], scene.before[frames.current]).tolist()
    rows, first = np.unique(frames.owner, return_index=True)
    for one in gone:
        members = rows[~frames.current[rows] & (scene.before[rows] == one)]
        if one == NO_HYPOTHESIS or len(members) < _LEAST_LOST:
            continue
        w = frames.w[first[np.searchsorted(rows, members)]]
        last = frames.stamps[last_true(w > 0)]
        earlier = (last.max() - last) * 1e-9
        at_once = np.count_nonzero(earlier <= _AT_ONCE)
        if at_once >= max(_LEAST_LOST, _MOST_OF * np.count_nonzero(earlier <= _BEFORE)):
            return True
    return False
