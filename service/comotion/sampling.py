"""Draws the trajectories that a method groups, and extends their partition to all the current ones.

The others keep their hypotheses. Those that have none join the group of the nearest trajectory that moves
alike.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from .arrays import Floats, Ints, Slots, find, ranks
from .matching import shared_counts
from .partition import NO_HYPOTHESIS, Partition
from .trajectories.window import Window

# Spaces up to so many trajectories are grouped as a whole.
_MIN_GROUPED = 200
# A trajectory with fewer observations does not show how it moves; it moves as in the last ns.
_MIN_OBSERVATIONS, _RECENT_NS = 3, 300_000_000
# A trajectory that has joined is less sure than one that was grouped, and counts for no box.
_JOINED_CONFIDENCE = 0.4
# Knuth's multiplier: numbers that follow each other are spread over the range of 32 bits.
_SPREAD = 2_654_435_761


def extended(window: Window, partition: Partition, grouped: Slots, current: Slots) -> Partition:
    """The groups of a partition of the `grouped` trajectories for all that are current, slots intp [n]."""
    groups, deciding = np.full(window.capacity, NO_HYPOTHESIS), np.zeros(window.capacity, np.bool_)
    confidence = np.zeros(window.capacity)
    groups[partition.slots], deciding[partition.slots] = partition.groups, partition.deciding
    confidence[grouped] = partition.confidence
    others = np.setdiff1d(current, partition.slots)
    # The group that has most members of a hypothesis now takes the others.
    count = int(partition.groups.max(initial=0)) + 1
    known, shared = shared_counts(window.label[partition.slots], partition.groups, count)
    heirs = np.append(np.where(shared.any(axis=1), shared.argmax(axis=1), NO_HYPOTHESIS), NO_HYPOTHESIS)
    groups[others] = heirs[find(window.label[others], known)]
    new = others[groups[others] == NO_HYPOTHESIS]
    groups[new] = _by_place_and_motion(window, new, current, groups[current])
    confidence[others] = np.where(groups[others] == NO_HYPOTHESIS, 0.0, _JOINED_CONFIDENCE)
    slots = np.union1d(current, partition.slots)
    return replace(
        partition,
        slots=slots,
        groups=groups[slots],
        deciding=deciding[slots],
        confidence=confidence[current],
        position=window.newest(current),
    )


def representatives(window: Window, current: Slots, share: float) -> Slots:
    """A share of the current trajectories, as many of every hypothesis, in the order of `current`, intp [m].

    Small spaces are taken whole; the same ones are taken again.
    """
    count = max(round(share * len(current)), _MIN_GROUPED)
    if count >= len(current):
        return current
    spread = window.key[current] * _SPREAD % 2**32
    return current[np.sort(np.lexsort((spread, ranks(window.label[current], spread)))[:count])]


def _by_place_and_motion(window: Window, new: Slots, current: Slots, groups: Ints) -> Ints:
    """Group of the nearest member that moves alike, intp [n]; NO_HYPOTHESIS where motion does not show."""
    joined = np.full(len(new), NO_HYPOTHESIS)
    measured = window.counts(new) >= _MIN_OBSERVATIONS
    members = np.flatnonzero((groups != NO_HYPOTHESIS) & (window.counts(current) >= _MIN_OBSERVATIONS))
    if not measured.any() or len(members) < 2:
        return joined
    place, motion = _states(window, current[members])
    own_place, own_motion = _states(window, new[measured])
    # The nearest member tells how far apart members are, and how differently they move.
    distance, neighbour = cKDTree(place).query(place, k=2)
    width = float(np.median(distance[:, 1])) + 1e-12
    spread = float(np.median(np.linalg.norm(motion - motion[neighbour[:, 1]], axis=1))) + 1e-12
    nearest = cKDTree(np.hstack([place / width, motion / spread]))
    _, rows = nearest.query(np.hstack([own_place / width, own_motion / spread]))
    joined[measured] = groups[members[rows]]
    return joined


def _states(window: Window, slots: Slots) -> tuple[Floats, Floats]:
    """Newest positions and recent velocities, float64 [n, dim], in the unit of the space and per second."""
    step, elapsed = window.recent_steps(slots, _RECENT_NS)
    return window.newest(slots), step / np.maximum(elapsed, 1)[:, None] * 1e9
