"""In a scene and its labels, out the newborn of which place tells nothing (after step 9)."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Bools, Ints
from ..partition import NO_HYPOTHESIS
from .assignment import LEAST_ENDED_FRAMES, OUTLIER
from .subset import Scene

# Neighbours that are asked, and how many of them must be newborn too.
_ASKED, _NEWBORN = 4, 2
# Features that a hypothesis has lost, so that it may return.
_LEAST_LOST = 3


def undecided(scene: Scene, labels: Ints) -> Ints:
    """The labels, intp [N], but :data:`OUTLIER` for features that may be a lost body's return.

    The static body is at home everywhere: by place alone, all features of a body that returns would be its.
    So while a hypothesis has lost all its features, what appears amid other newborn features belongs to
    nobody until its motion is known.
    """
    frames = scene.frames
    newborn = frames.current & ~scene.judged & (scene.before == NO_HYPOTHESIS)
    doubtful = newborn & (labels == 0)
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
    """Whether a hypothesis of several features has none that goes on."""
    frames = scene.frames
    ended: Bools = ~frames.current & (frames.life >= LEAST_ENDED_FRAMES)
    gone, counts = np.unique(scene.before[ended], return_counts=True)
    lost = gone[(counts >= _LEAST_LOST) & (gone != NO_HYPOTHESIS)]
    return bool((~np.isin(lost, scene.before[frames.current])).any())
