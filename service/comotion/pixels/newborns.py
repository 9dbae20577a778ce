"""Assigns trajectories that are too short to be compared by the groups of their nearest neighbours."""

import numpy as np
from scipy.spatial import cKDTree

from ..arrays import Floats, Ints, Slots
from ..partition import NO_HYPOTHESIS
from ..trajectories.window import Window

# Nearest neighbours that vote, and px that are added to their distance.
_VOTERS, _SOFT_PX = 5, 5.0
# ns; time over which motion is compared, and px of distance that a px of difference in it counts for.
_MOTION_NS, _MOTION_WEIGHT = 100_000_000, 10.0


def assign_newborns(window: Window, newborn: Slots, labelled: Slots, groups: Ints) -> tuple[Ints, Floats]:
    """Groups of newborn trajectories by the vote of the nearest in the image that move as they do.

    Parameters
    ----------
    window
        Store of all trajectories.
    newborn, labelled
        Slots intp [n] of trajectories too short to be compared, and intp [m] of others, which have the
        `groups` intp [m].

    Returns
    -------
    groups intp [n] (NO_HYPOTHESIS without neighbours) and the share of votes float64 [n].
    """
    slots, count = np.concatenate([newborn, labelled]), int(groups.max(initial=-1)) + 1
    labels = np.concatenate([np.full(len(newborn), NO_HYPOTHESIS), groups])
    step, span = window.recent_steps(slots, _MOTION_NS)
    motion = _MOTION_WEIGHT * step * (_MOTION_NS / np.maximum(span, 1))[:, None]
    votes = nearest_votes(np.hstack([window.newest(slots), motion]), labels, count, np.inf)[: len(newborn)]
    if not votes.any():
        return np.full(len(newborn), NO_HYPOTHESIS), np.zeros(len(newborn))
    return votes.argmax(axis=1), votes.max(axis=1)


def nearest_votes(place: Floats, labels: Ints, count: int, reach: float) -> Floats:
    """Share of each of `count` labels among the nearest labelled neighbours within reach, float64 [n, count].

    The shares of few neighbours come to less than 1: another one may lie just beyond the reach.

    Parameters
    ----------
    place
        float64 [n, D], px; the distance is that in D dimensions.
    labels
        intp [n], negative for none; no trajectory is its own neighbour.
    reach
        px.
    """
    labelled = np.flatnonzero(labels >= 0)
    votes = np.zeros((len(place), count))
    if len(labelled) < 2:
        return votes
    distance, nearest = cKDTree(place[labelled]).query(place, k=min(_VOTERS + 1, len(labelled)))
    near = (distance < reach) & (labelled[nearest] != np.arange(len(place))[:, None])
    np.add.at(
        votes, (np.arange(len(place))[:, None], labels[labelled[nearest]]), near / (distance + _SOFT_PX)
    )
    return np.asarray(votes / np.maximum(votes.sum(axis=1, keepdims=True) + 1 / (reach + _SOFT_PX), 1e-12))
