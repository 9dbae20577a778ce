"""Groups trajectories by their motion on key frames, and decides the number of groups.

The distance of two features of one rigid body changes in the image. Here two trajectories are compared by the
local motions that explain both, and by the subspace that they span together. The steps of the method:

2. Fit local affine motions to random groups of neighbours (:mod:`.neighbour_sampling`).
3. Compute the preference kernel: do the same local motions explain two trajectories (:mod:`.similarity`)?
4. Combine it with shape interaction: do they lie in one subspace (:mod:`.similarity`)?
5. Link trajectories to superclusters by average linkage, each within one body and one hypothesis so far.
6. Merge superclusters while boundary contrast and epipolar geometry allow it; this decides the number of
   objects (:mod:`.merging`, :mod:`.consensus`, :mod:`.geometry`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ..arrays import Floats, Floats32, Ints, Labels
from ..config import PixelsConfig
from .consensus import consensus
from .distances import distances
from .geometry import Geometry
from .key_frames import KeyFrames
from .merging import Merging
from .neighbour_sampling import sample_members
from .similarity import combine, explain, preference, subspace

# Mean similarity down to which a group lies within one body: .15 % of the members are of another one on
# Hopkins155.
_LEAST_SIMILARITY = 0.08
# Mean similarity that a rival of the own group has at least, where there is none.
_RIVAL = 0.0075


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
        float32 [N, N], 0..1; what the groups were found from.
    """

    labels: Ints
    confidence: Floats
    similarity: Floats32


def group(frames: KeyFrames, parameters: PixelsConfig, previous: Labels) -> Grouping:
    """Group trajectories by motion and find the number of groups: steps 2 to 6.

    The draw of local motions is fixed: same input, same groups.

    Parameters
    ----------
    frames
        F key frames of N ≥ 2 trajectories.
    parameters
        Of the method.
    previous
        int64 [N]; hypotheses of the trajectories at the previous update, negative for none.
    """
    distance = distances(frames)
    members = sample_members(distance.local, parameters.local_motions, np.random.default_rng(0))  # 2
    kernel = preference(explain(frames, members), frames.variance)  # 3
    similarity = combine(kernel, subspace(frames))  # 4
    superclusters = _apart(link(similarity), previous, parameters.smallest)  # 5
    pieces = [np.flatnonzero(superclusters == k) for k in range(superclusters.max() + 1)]
    agreed = consensus(frames, pieces, np.random.default_rng(0))
    geometry = Geometry(frames, parameters.drift)
    merging = Merging(
        similarity, distance.image, superclusters, agreed, geometry, parameters.smallest, previous
    )
    merged = merging.groups()  # 6
    _, labels = np.unique(merged[superclusters], return_inverse=True)
    mean = similarity @ np.eye(labels.max() + 1)[labels] / np.bincount(labels)
    return Grouping(labels, _confidence(mean, labels), similarity)


def link(similarity: Floats32) -> Ints:
    """Superclusters of trajectories, intp [N], by average linkage."""
    # The floors of its factors can lift a similarity above 1.
    tree = linkage(squareform(np.maximum(1 - similarity, 0), checks=False), "average")
    return np.asarray(fcluster(tree, 1 - _LEAST_SIMILARITY, "distance").astype(np.intp) - 1)


def _apart(superclusters: Ints, previous: Labels, smallest: int) -> Ints:
    """Superclusters without what was several hypotheses: bodies that moved apart move alike for a while."""
    parts = superclusters.copy()
    for k in range(superclusters.max() + 1):
        members = np.flatnonzero((superclusters == k) & (previous >= 0))
        ids, counts = np.unique(previous[members], return_counts=True)
        for name in ids[counts >= smallest][1:]:
            parts[members[previous[members] == name]] = parts.max() + 1
    return parts


def _confidence(mean: Floats, labels: Ints) -> Floats:
    rows = np.arange(len(labels))
    own = mean[rows, labels]
    others = mean.copy()
    others[rows, labels] = 0
    rival = np.maximum(others.max(axis=1), _RIVAL)
    share: Floats = np.clip(own / (own + rival), 0.0, 1.0)
    return share
