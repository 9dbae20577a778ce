"""Key frames in; groups of the trajectories by motion, and their number, out.

The distance of two features of one rigid body changes in the image. Here two trajectories are compared by the
local motions that explain both, and by the subspace that they span together. The steps of the method:

2. Fit local affine motions to random groups of neighbours (:mod:`.neighbour_sampling`, :mod:`.affine`).
3. Compute the preference kernel: do the same local motions explain two trajectories (:mod:`.similarity`)?
4. Combine it with shape interaction: do they lie in one subspace (:mod:`.similarity`)?
5. Link trajectories to superclusters, each within one body (:mod:`.linkage`).
6. Merge superclusters while boundary contrast and epipolar geometry allow it; this decides the number of
   objects (:mod:`.merging`, :mod:`.epipolar`, :mod:`.wide_baseline`).
"""

from dataclasses import dataclass

import numpy as np

from ..arrays import Floats, Ints, Labels
from ..config import PixelsConfig
from .affine import explain
from .epipolar import EpipolarTest
from .key_frames import KeyFrames, frame_pairs
from .linkage import link, pool
from .merging import SIMILARITY, BoundaryContrast, merge
from .neighbour_sampling import sample_members
from .similarity import Similarity, combine, preference, subspace
from .wide_baseline import WideBaselineTest


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

    labels: Ints
    confidence: Floats
    similarity: Similarity


def group(
    frames: KeyFrames, parameters: PixelsConfig, *, seed: int = 0, previous: Labels | None = None
) -> Grouping:
    """Group trajectories by motion and find the number of groups: steps 2 to 6.

    Parameters
    ----------
    frames
        F key frames of N ≥ 2 trajectories.
    parameters
        Of the method.
    seed
        Of the draw of local motions: same input, same groups.
    previous
        int64 [N]; hypotheses of the trajectories at the previous update, negative for none.
    """
    pairs = frame_pairs(frames)
    members = sample_members(frames, parameters.local_motions, np.random.default_rng(seed))  # 2
    residuals = explain(pairs, members)
    kernel = preference(residuals, pairs.seen, frames.variance)  # 3
    similarity = combine(kernel, subspace(frames))  # 4
    superclusters = link(similarity)  # 5
    boundary, epipolar = BoundaryContrast(frames, similarity.value), EpipolarTest(frames)
    wide_baseline = WideBaselineTest(frames, superclusters.members(), parameters.drift)
    merged = merge(superclusters, boundary, epipolar, wide_baseline, parameters.smallest, previous)  # 6
    _, labels = np.unique(merged[superclusters.of], return_inverse=True)
    weighted, evidence = pool(similarity, labels)
    return Grouping(labels, _confidence((weighted / evidence).T, labels), similarity)


def _confidence(mean: Floats, labels: Ints) -> Floats:
    rows = np.arange(len(labels))
    own = mean[rows, labels]
    others = mean.copy()
    others[rows, labels] = 0
    rival = np.maximum(others.max(axis=1), SIMILARITY)
    share: Floats = np.clip(own / (own + rival), 0.0, 1.0)
    return share
