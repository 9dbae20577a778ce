"""Groups trajectories by their motion on key frames, and decides the number of groups.

The distance of two features of one rigid body changes in the image. Here two trajectories are compared by the
local motions that explain both, and by the subspace that they span together. The steps of the method:

2. Fit local affine motions to random groups of neighbours (:mod:`.neighbours`).
3. Compute the preference kernel: do the same local motions explain two trajectories (:mod:`.similarity`)?
4. Combine it with shape interaction: do they lie in one subspace (:mod:`.similarity`)?
5. Link trajectories to superclusters by average linkage, each within one body and one hypothesis so far.
6. Merge superclusters while boundary contrast and epipolar geometry allow it; this decides the number of
   objects (:mod:`.merging`, :mod:`.consensus`).
"""

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform

from ..arrays import Floats, Floats32, Ints, Labels
from .consensus import consensus
from .key_frames import KeyFrames
from .merging import SMALLEST, merged
from .neighbours import distances, sample_members
from .similarity import combine, explain, preference, subspace

# Mean similarity down to which a group lies within one body: .15 % of the members are of another one on
# Hopkins155.
_LEAST_SIMILARITY = 0.08
# Consensus that counts against one body for two superclusters that were two hypotheses: what has moved apart
# may move alike for a while.
_HELD_APART = 0.1875
# Mean similarity to a group that is not known.
_UNKNOWN = 0.0075


def group(frames: KeyFrames, previous: Labels) -> tuple[Ints, Floats, Floats32]:
    """Group trajectories by motion and find the number of groups: steps 2 to 6.

    The draw of local motions is fixed: same input, same groups.

    Parameters
    ----------
    frames
        F key frames of N ≥ 2 trajectories.
    previous
        int64 [N]; hypotheses of the trajectories at the previous update, negative for none.

    Returns
    -------
    Groups intp [N], 0 to K − 1; confidence float64 [N], 0..1: similarity to the own group over that to all;
    similarity float32 [N, N], 0..1: what the groups were found from.
    """
    distance, local = distances(frames)
    members = sample_members(local, np.random.default_rng(0))  # 2
    kernel = preference(explain(frames, members), frames.variance)  # 3
    similarity = combine(kernel, subspace(frames))  # 4
    superclusters = _superclusters(similarity, previous)  # 5
    pieces = [np.flatnonzero(superclusters == k) for k in range(superclusters.max() + 1)]
    agreed = held_apart(consensus(frames, pieces, np.random.default_rng(0)), pieces, previous)
    labels = merged(similarity, distance, superclusters, agreed)  # 6
    mean = similarity @ np.eye(labels.max() + 1)[labels] / np.bincount(labels)
    return labels, mean[np.arange(len(labels)), labels] / (mean.sum(axis=1) + _UNKNOWN), similarity


def _superclusters(similarity: Floats32, previous: Labels) -> Ints:
    """Superclusters of trajectories, intp [N], by average linkage, each of one hypothesis so far.

    Bodies that moved apart move alike for a while.
    """
    # The floors of its factors can lift a similarity above 1.
    tree = linkage(squareform(np.maximum(1 - similarity, 0), checks=False), "average")
    parts: Ints = fcluster(tree, 1 - _LEAST_SIMILARITY, "distance").astype(np.intp) - 1
    for k in range(parts.max() + 1):
        members = np.flatnonzero((parts == k) & (previous >= 0))
        ids, counts = np.unique(previous[members], return_counts=True)
        for name in ids[counts >= SMALLEST][1:]:
            parts[members[previous[members] == name]] = parts.max() + 1
    return parts


def held_apart(agreed: Floats, pieces: list[Ints], previous: Labels) -> Floats:
    """Consensus of superclusters, [P, P], less where most of their members were of two hypotheses."""
    counted = [np.unique(previous[members], return_counts=True) for members in pieces]
    name = np.array([ids[counts.argmax()] for ids, counts in counted])
    were_two = (name[:, None] != name) & (np.minimum(name[:, None], name) >= 0)
    return np.asarray(agreed - _HELD_APART * were_two)
