"""Trajectories on key frames to groups: the method of pixel spaces, top to bottom."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import PixelsConfig
from .epipolar import EpipolarTest
from .key_frames import KeyFrames
from .linkage import link, pool
from .merging import BoundaryContrast, merge
from .reassignment import label_hysteresis, reassign, vote_of_neighbours
from .similarity import Similarity, compare


@dataclass(frozen=True)
class Grouping:
    """Groups of N trajectories.

    Attributes
    ----------
    labels
        intp [N], 0 to K − 1.
    confidence
        float64 [N], 0..1; similarity to the own group over that to the own and the best other.
    similarity
        What the groups were found from.
    """

    labels: NDArray[np.intp]
    confidence: NDArray[np.float64]
    similarity: Similarity


def group(
    frames: KeyFrames,
    parameters: PixelsConfig,
    *,
    seed: int = 0,
    before: NDArray[np.int64] | None = None,
) -> Grouping:
    """Group trajectories by motion; their number of groups is found, not given.

    Parameters
    ----------
    frames
        F key frames of N ≥ 2 trajectories.
    parameters
        See :class:`~comotion.PixelsConfig`.
    seed
        Of the draw of local motions: same input, same groups.
    before
        int64 [N]; hypotheses of the trajectories at the previous update, negative for none.
    """
    similarity = compare(frames, parameters, np.random.default_rng(seed))
    superclusters = link(similarity, parameters.piece_similarity)
    boundary = BoundaryContrast(frames, similarity.value)
    merged = merge(superclusters, boundary, EpipolarTest(frames), parameters, before)
    _, labels = np.unique(merged[superclusters.of], return_inverse=True)
    labels, explained = reassign(frames, labels, parameters.ridge)
    weighted, evidence = pool(similarity, labels)
    mean = (weighted / evidence).T
    own_evidence = np.diagonal(similarity.evidence)
    labels = vote_of_neighbours(frames, own_evidence, mean, labels)
    if before is not None:
        labels = label_hysteresis(own_evidence, explained, labels, before)
    return Grouping(labels, _confidence(mean, labels, parameters.merge_similarity), similarity)


def _confidence(mean: NDArray[np.float64], labels: NDArray[np.intp], least: float) -> NDArray[np.float64]:
    rows = np.arange(len(labels))
    own = mean[rows, labels]
    others = mean.copy()
    others[rows, labels] = 0
    rival = np.maximum(others.max(axis=1), least)
    share: NDArray[np.float64] = np.clip(own / (own + rival), 0.0, 1.0)
    return share
