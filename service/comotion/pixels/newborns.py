"""Trajectories too short to be compared in; what their nearest neighbours say of them out."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Floats, Ints, Slots
from ..partition import NO_HYPOTHESIS
from ..trajectories.interpolation import recent_steps
from ..trajectories.window import Window

# Nearest neighbours that vote, and px that are added to their distance.
_VOTERS, _SOFT_PX = 5, 5.0
# ns; time over which motion is compared, and px of distance that a px of difference in it counts for.
_MOTION_NS, _MOTION_WEIGHT = 100_000_000, 10.0


def assign_newborns(window: Window, newborn: Slots, known: Slots, groups: Ints) -> tuple[Ints, Floats]:
    """Groups of newborn trajectories by the vote of the nearest in the image that move as they do.

    Parameters
    ----------
    window
        Store of all trajectories.
    newborn, known
        Slots intp [n] of trajectories too short to be compared, and intp [m] of others, which have the
        `groups` intp [m].

    Returns
    -------
    groups intp [n] (NO_HYPOTHESIS without neighbours) and the share of votes float64 [n].
    """
    both, count = np.concatenate([newborn, known]), int(groups.max(initial=-1)) + 1
    labels = np.concatenate([np.full(len(newborn), NO_HYPOTHESIS), groups])
    step, span = recent_steps(window, both, _MOTION_NS)
    motion = _MOTION_WEIGHT * step * (_MOTION_NS / np.maximum(span, 1))[:, None]
    place = window.positions[both, window.stop[both] - 1]
    alike = nearest_votes(np.hstack([place, motion]), labels, count, np.inf)
    # One that was seen once has a place, and no motion.
    near = nearest_votes(place, labels, count, np.inf)
    votes = np.where((span > 0)[:, None], alike, near)[: len(newborn)]
    if not votes.any():
        return np.full(len(newborn), NO_HYPOTHESIS), np.zeros(len(newborn))
    return votes.argmax(axis=1), votes.max(axis=1)


def nearest_votes(place: Floats, labels: Ints, count: int, reach: float) -> Floats:
    """Share of each of `count` labels among the nearest labelled neighbours within reach, float64 [n, count].

    Parameters
    ----------
    place
        float64 [n, D], px; the distance is that in D dimensions.
    labels
        intp [n], negative for none; nobody is a neighbour of their own.
    reach
        px.
    """
    known = np.flatnonzero(labels >= 0)
    votes = np.zeros((len(place), count))
    if len(known) < 2:
        return votes
    apart, at = cKDTree(place[known]).query(place, k=min(_VOTERS + 1, len(known)))
    near = (apart < reach) & (known[at] != np.arange(len(place))[:, None])
    np.add.at(votes, (np.arange(len(place))[:, None], labels[known[at]]), near / (apart + _SOFT_PX))
    return np.asarray(votes / np.maximum(votes.sum(axis=1, keepdims=True), 1e-12))
