"""Trajectories too short to be compared in; labels of the nearest that move as they do out."""

import numpy as np

from ..arrays import Floats, Labels, Slots
from ..partition import NO_HYPOTHESIS
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window
from .kernels.neighbours import newborn_distances, weighted_votes
from .key_frames import evenly_spaced
from .neighbour_sampling import MOTION_WEIGHT

# Nearest trajectories that vote.
_VOTERS = 5
# Observations of a newborn trajectory that are compared.
_INSTANTS = 4
# What the previous label of a newborn trajectory counts, in average votes.
_PREVIOUS_VOTES = 1.0


def assign_newborns(
    window: Window, newborn: Slots, compared: Slots, labels: Labels, previous: Labels
) -> tuple[Labels, Floats]:
    """Labels of newborn trajectories by the vote of the nearest in the image that move as they do.

    Parameters
    ----------
    window
        Store of all trajectories.
    newborn, compared
        Slots intp [n] of trajectories too short to be compared, and intp [m] of compared ones, which have
        the `labels` int64 [m].
    previous
        int64 [n]; labels of the newborn ones until now: each counts as one vote.

    Returns
    -------
    labels int64 [n] (NO_HYPOTHESIS where nothing is near in time) and the share of votes float64 [n].
    """
    if not len(compared):
        return np.full(len(newborn), NO_HYPOTHESIS), np.zeros(len(newborn))
    distance = _distance(window, newborn, compared)
    return weighted_votes(distance, labels, previous, _VOTERS, _PREVIOUS_VOTES)


def _distance(window: Window, newborn: Slots, compared: Slots) -> Floats:
    """Distances at some instants of the newborn ones, float64 [n, m] px; inf where none is shared."""
    at = [window.start[s] + evenly_spaced(int(window.stop[s] - window.start[s]), _INSTANTS) for s in newborn]
    owner = np.repeat(np.arange(len(newborn)), [len(each) for each in at])
    index = np.concatenate(at)
    # Features are born together: the states of the compared ones serve several.
    stamps, instant = np.unique(window.times[newborn[owner], index], return_inverse=True)
    states = states_at(window, compared, stamps)
    own = window.positions[newborn[owner], index]
    return newborn_distances(states.position, states.held, own, instant, owner, len(newborn), MOTION_WEIGHT)
