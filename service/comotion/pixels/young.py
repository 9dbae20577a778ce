"""Trajectories that are too young to be compared start from their neighbours."""

import numpy as np
from numpy.typing import NDArray

from ..engine import NO_HYPOTHESIS
from ..states import states_at
from ..window import Floats, Slots, Window
from .keyframes import spread

_VOTERS = 5
_INSTANTS = 4
_HELD_VOTES = 1.0

Labels = NDArray[np.int64]


def adopt(window: Window, young: Slots, grown: Slots, labels: Labels, held: Labels) -> tuple[Labels, Floats]:
    """Labels of young trajectories by the vote of those near them in the image.

    Parameters
    ----------
    window
        Store of all trajectories.
    young, grown
        Slots, intp [n] and [m]; the grown ones are labelled `labels` int64 [m].
    held
        int64 [n]; what the young ones were labelled until now: worth one vote.

    Returns
    -------
    labels int64 [n] (NO_HYPOTHESIS where nothing is near in time) and the share of votes [n].
    """
    found = np.full(len(young), NO_HYPOTHESIS)
    share = np.zeros(len(young))
    if not len(grown):
        return found, share
    for k, slot in enumerate(young.tolist()):
        distance = _distance(window, slot, grown)
        near = np.argsort(distance, kind="stable")[:_VOTERS]
        near = near[np.isfinite(distance[near])]
        if len(near):
            found[k], share[k] = _vote(labels[near], int(held[k]))
    return found, share


def _vote(near: Labels, held: int) -> tuple[int, float]:
    candidates, votes = np.unique(near, return_counts=True)
    weight = votes + _HELD_VOTES * (candidates == held)
    best = int(weight.argmax())
    return int(candidates[best]), float(votes[best] / len(near))


def _distance(window: Window, slot: int, grown: Slots) -> Floats:
    """Mean distance in the image at some instants of the young one, px [m]; inf where none is shared."""
    at = window.start[slot] + spread(int(window.stop[slot] - window.start[slot]), _INSTANTS)
    total, count = np.zeros(len(grown)), np.zeros(len(grown))
    for index in at.tolist():
        states = states_at(window, grown, int(window.times[slot, index]))
        step = np.linalg.norm(states.position - window.positions[slot, index], axis=1)
        total += np.where(states.held, step, 0.0)
        count += states.held
    return np.where(count > 0, total / np.maximum(count, 1), np.inf)
