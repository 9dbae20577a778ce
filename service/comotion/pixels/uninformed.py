"""Trajectories that were seen while next to nothing moved: their neighbours know better, or their past."""

import numpy as np
from numpy.typing import NDArray

from .keyframes import Floats32, KeyFrames
from .sampling import Neighbours

_EVIDENCE = 0.02
_RIVAL = 0.5
_VOTERS = 5

Labels = NDArray[np.intp]


def ask_neighbours(
    frames: KeyFrames, own_evidence: Floats32, mean: NDArray[np.float64], labels: Labels
) -> Labels:
    """Labels of trajectories, those of the uninformed by the vote of the nearest in the image.

    Uninformed is who was not seen while most of the motion took place and fits two groups nearly
    equally well. It chooses among these groups only.

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
    fits = mean >= _RIVAL * mean.max(axis=1, keepdims=True)
    unsure = np.flatnonzero((own_evidence < _EVIDENCE) & (fits.sum(axis=1) > 1))
    sure = np.flatnonzero(fits.sum(axis=1) == 1)
    if not len(unsure) or not len(sure):
        return labels
    distance = Neighbours(frames, 0.0).distance(unsure)[:, sure]
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :_VOTERS]
    member = np.eye(mean.shape[1])[labels[sure[nearest]]]
    near = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
    votes = (member * near[..., None]).sum(axis=1) * fits[unsure]
    settled = labels.copy()
    settled[unsure] = np.where(votes.any(axis=1), votes.argmax(axis=1), labels[unsure])
    return settled


def hold(
    own_evidence: Floats32, explained: NDArray[np.bool_], labels: Labels, before: NDArray[np.int64]
) -> Labels:
    """Labels of trajectories, those of the uninformed as before while that explains them.

    What rests is explained by everything that rests, and linkage puts it here now and there then.

    Parameters
    ----------
    own_evidence, labels
        See :func:`ask_neighbours`.
    explained
        bool [K, N]; whether a group's motion explains a trajectory.
    before
        int64 [N]; hypotheses at the previous update, negative for none. A group goes on with that
        which most of its informed members had.
    """
    informed = own_evidence >= _EVIDENCE
    was = [_usual(before[(labels == group) & informed]) for group in range(len(explained))]
    stays = explained & (np.array(was)[:, None] == before) & ~informed & (before >= 0)
    stays[:, stays[labels, np.arange(len(labels))]] = False
    return np.where(stays.any(axis=0), stays.argmax(axis=0), labels)


def _usual(values: NDArray[np.int64]) -> int:
    """The most frequent value, -1 of none."""
    if not len(values):
        return -1
    known, counts = np.unique(values, return_counts=True)
    return int(known[counts.argmax()])
