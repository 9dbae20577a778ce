"""Trajectories that are too young to be compared start from their neighbours."""

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Slots
from ..compiled import compiled
from ..partition import NO_HYPOTHESIS
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window
from .continuity import smallest
from .keyframes import spread

_VOTERS = 5
_INSTANTS = 4
_HELD_VOTES = 1.0
# px; added to distances, so that one that is next to nothing does not outweigh all others.
_NEAR_PX = 1.0

Labels = NDArray[np.int64]


def adopt(
    window: Window, young: Slots, grown: Slots, labels: Labels, held: Labels, motion_weight: float
) -> tuple[Labels, Floats]:
    """Labels of young trajectories by the vote of those near them in the image that move as they do.

    Parameters
    ----------
    window
        Store of all trajectories.
    young, grown
        Slots, intp [n] and [m]; the grown ones are labelled `labels` int64 [m].
    held
        int64 [n]; what the young ones were labelled until now: worth one vote.
    motion_weight
        See :class:`~comotion.pixels.sampling.Neighbours`.

    Returns
    -------
    labels int64 [n] (NO_HYPOTHESIS where nothing is near in time) and the share of votes [n].
    """
    if not len(grown):
        return np.full(len(young), NO_HYPOTHESIS), np.zeros(len(young))
    return _votes(_distance(window, young, grown, motion_weight), labels, held)


@compiled()
def _votes(distance: Floats, labels: Labels, held: Labels) -> tuple[Labels, Floats]:
    """Label with most votes of the nearest, the smaller of equals, and its share of votes.

    The nearer, the more a vote counts (Dudani 1976): of five some may be far away on another body.
    """
    found = np.full(len(distance), NO_HYPOTHESIS)
    share = np.zeros(len(distance))
    for k in range(len(distance)):
        near = smallest(distance[k], _VOTERS)
        near = near[np.isfinite(distance[k][near])]
        worth = 1 / (distance[k][near] + _NEAR_PX)
        worth *= len(near) / worth.sum()
        most = 0.0
        for label in np.sort(labels[near]):
            votes = worth[labels[near] == label].sum()
            weight = votes + _HELD_VOTES * (held[k] == label)
            if weight > most:
                most, found[k], share[k] = weight, label, votes / len(near)
    return found, share


def _distance(window: Window, young: Slots, grown: Slots, motion_weight: float) -> Floats:
    """Distances at some instants of the young ones, px [n, m]; inf where none is shared."""
    at = [window.start[s] + spread(int(window.stop[s] - window.start[s]), _INSTANTS) for s in young]
    owner = np.repeat(np.arange(len(young)), [len(each) for each in at])
    index = np.concatenate(at)
    # Features are born together: the states of the grown ones serve several.
    stamps, when = np.unique(window.times[young[owner], index], return_inverse=True)
    states = states_at(window, grown, stamps)
    own = window.positions[young[owner], index]
    return _weighted(states.position, states.held, own, when, owner, len(young), motion_weight)


@compiled()
def _weighted(
    positions: Floats, held: Bools, own: Floats, when: Slots, owner: Slots, count: int, motion_weight: float
) -> Floats:
    """Mean distance in the image plus weighted root mean square of that of displacements, [count, m]."""
    shape = count, held.shape[1]
    total, shared, square, moves = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for k in range(len(own)):
        n, t = owner[k], when[k]
        moved = k > 0 and owner[k - 1] == n
        for j in range(held.shape[1]):
            if held[t, j]:
                x, y = positions[t, j, 0] - own[k, 0], positions[t, j, 1] - own[k, 1]
                total[n, j] += np.sqrt(x * x + y * y)
                shared[n, j] += 1
                if moved and held[when[k - 1], j]:
                    x -= positions[when[k - 1], j, 0] - own[k - 1, 0]
                    y -= positions[when[k - 1], j, 1] - own[k - 1, 1]
                    square[n, j] += x * x + y * y
                    moves[n, j] += 1
    for n in range(count):
        for j in range(held.shape[1]):
            if shared[n, j] > 0:
                total[n, j] = total[n, j] / shared[n, j]
                total[n, j] += motion_weight * np.sqrt(square[n, j] / max(moves[n, j], 1.0))
            else:
                total[n, j] = np.inf
    return total
