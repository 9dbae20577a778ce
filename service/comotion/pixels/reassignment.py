"""Groups of trajectories in; labels of single trajectories that the grouping leaves wrong or open out."""

from typing import NamedTuple

import numpy as np

from ..arrays import Bools, Floats, Floats32, Ints, Labels, Slots
from ..partition import NO_HYPOTHESIS
from ..trajectories.interpolation import states_at
from ..trajectories.window import Window
from .affine import RIDGE
from .kernels.affine import group_deviations
from .kernels.neighbours import newborn_distances, weighted_votes
from .key_frames import KeyFrames, evenly_spaced, frame_pairs
from .neighbour_sampling import MOTION_WEIGHT, NeighbourDistance

# Key frames from the first to the second of a pair. Over pairs 3 apart the labelled recordings get worse,
# see docs/pixels.md.
_PAIR_STEP = 4
# Pairs that must show a trajectory before it is reassigned.
_LEAST_PAIRS = 3
# Squared deviations in variances per axis of the group's own: two axes add up to 2 on average. A trajectory
# is explained below the first mean, contradicted above the second value (four standard deviations). A
# deviation counts up to the third.
_EXPLAINED = 3.0
_CONTRADICTED = 16.0
_LARGEST_DEVIATION = 25.0

# A trajectory with less evidence was not seen while most of the motion took place.
_LEAST_EVIDENCE = 0.02
# A group fits a trajectory if its similarity is at least this share of the best group's.
_FITTING_SHARE = 0.5
# Nearest trajectories that vote.
_VOTERS = 5

# Observations of a newborn trajectory that are compared.
_NEWBORN_INSTANTS = 4
# What the previous label of a newborn trajectory counts, in average votes.
_PREVIOUS_VOTES = 1.0


class Reassigned(NamedTuple):
    """Groups of N trajectories after reassignment.

    Attributes
    ----------
    labels
        intp [N], 0 to K − 1.
    explained
        bool [K, N]; whether a trajectory deviates from a group's motion no more than members do. False
        where no pair of key frames shows it.
    """

    labels: Ints
    explained: Bools


def reassign(frames: KeyFrames, labels: Ints) -> Reassigned:
    """Give trajectories that their own group's motion contradicts to the group that explains them.

    Linkage compares neighbours, and a local motion that is fitted across a boundary explains a little of
    both sides. A trajectory at the boundary of one body but far from the rest of its own can so end in the
    other. The motion of whole groups shows that: the trajectory deviates from its group's motion by more
    than four standard deviations in two pairs of key frames, and on average no more than members do from
    another group's. The motion of a group over a pair is an affine displacement field. In strong
    perspective that explains no group well; then the members' own deviations are as large.

    Parameters
    ----------
    frames
        F key frames of N trajectories.
    labels
        intp [N], 0 to K − 1.
    """
    pairs, groups = len(frames.positions) - _PAIR_STEP, int(labels.max()) + 1
    if pairs < _LEAST_PAIRS or groups < 2:
        return Reassigned(labels, np.zeros((groups, len(labels)), np.bool_))
    shown = frame_pairs(frames, (_PAIR_STEP,))
    own, every = group_deviations(shown.start, shown.displacement, shown.seen, labels, groups, RIDGE)
    known = np.isfinite(own) & np.isfinite(every)
    count = known.sum(axis=1)
    mean = np.where(known, np.minimum(every, _LARGEST_DEVIATION), 0).sum(axis=1) / np.maximum(count, 1)
    explained = (mean < _EXPLAINED) & (count > 0)
    contradicted = np.partition(np.where(known, own, 0), -2, axis=1)[:, -2] > _CONTRADICTED
    fits = contradicted & explained & (count >= _LEAST_PAIRS) & (2 * count >= shown.seen.sum(axis=0))
    best = np.where(fits, mean, np.inf).argmin(axis=0)
    kept, labels = np.unique(np.where(fits.any(axis=0), best, labels), return_inverse=True)
    return Reassigned(labels, explained[kept])


def vote_of_neighbours(frames: KeyFrames, own_evidence: Floats32, mean: Floats, labels: Ints) -> Ints:
    """Labels after trajectories with little evidence have taken that of their nearest neighbours.

    They were not seen while most of the motion took place and fit several groups nearly equally well. Their
    neighbours in the image choose among these groups only.

    Parameters
    ----------
    frames
        N trajectories.
    own_evidence
        float32 [N]; evidence of each trajectory with itself, 1 if it was seen throughout.
    mean
        float64 [N, K]; similarity of each trajectory to each group.
    labels
        intp [N].
    """
    fits = mean >= _FITTING_SHARE * mean.max(axis=1, keepdims=True)
    unsure = np.flatnonzero((own_evidence < _LEAST_EVIDENCE) & (fits.sum(axis=1) > 1))
    sure = np.flatnonzero(fits.sum(axis=1) == 1)
    if not len(unsure) or not len(sure):
        return labels
    distance = NeighbourDistance(frames, 0.0).to_all(unsure)[:, sure]
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :_VOTERS]
    member = np.eye(mean.shape[1])[labels[sure[nearest]]]
    near = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
    votes = (member * near[..., None]).sum(axis=1) * fits[unsure]
    settled = labels.copy()
    settled[unsure] = np.where(votes.any(axis=1), votes.argmax(axis=1), labels[unsure])
    return settled


def label_hysteresis(own_evidence: Floats32, explained: Bools, labels: Ints, previous: Labels) -> Ints:
    """Labels after trajectories with little evidence have returned to the group of their hypothesis.

    They return only if that group's motion explains them. A trajectory at rest is explained by every
    group at rest, and without hysteresis its label would change between updates.

    Parameters
    ----------
    own_evidence, labels
        See :func:`vote_of_neighbours`.
    explained
        bool [K, N]; whether a group's motion explains a trajectory.
    previous
        int64 [N]; hypotheses at the previous update, negative for none. A group goes on with that
        which most of its members with enough evidence had.
    """
    enough = own_evidence >= _LEAST_EVIDENCE
    hypothesis = [_most_frequent(previous[(labels == group) & enough]) for group in range(len(explained))]
    returns = explained & (np.array(hypothesis)[:, None] == previous) & ~enough & (previous >= 0)
    returns[:, returns[labels, np.arange(len(labels))]] = False
    return np.where(returns.any(axis=0), returns.argmax(axis=0), labels)


def _most_frequent(values: Labels) -> int:
    """The most frequent value, -1 of none."""
    if not len(values):
        return -1
    known, counts = np.unique(values, return_counts=True)
    return int(known[counts.argmax()])


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
    distance = _newborn_distance(window, newborn, compared)
    return weighted_votes(distance, labels, previous, _VOTERS, _PREVIOUS_VOTES)


def _newborn_distance(window: Window, newborn: Slots, compared: Slots) -> Floats:
    """Distances at some instants of the newborn ones, float64 [n, m] px; inf where none is shared."""
    at = [
        window.start[s] + evenly_spaced(int(window.stop[s] - window.start[s]), _NEWBORN_INSTANTS)
        for s in newborn
    ]
    owner = np.repeat(np.arange(len(newborn)), [len(each) for each in at])
    index = np.concatenate(at)
    # Features are born together: the states of the compared ones serve several.
    stamps, instant = np.unique(window.times[newborn[owner], index], return_inverse=True)
    states = states_at(window, compared, stamps)
    own = window.positions[newborn[owner], index]
    return newborn_distances(states.position, states.held, own, instant, owner, len(newborn), MOTION_WEIGHT)
