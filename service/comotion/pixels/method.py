"""The default method in spaces of unit px: image trajectories in, groups of them out.

The distance of two features of one rigid body changes in the image. Here two trajectories are compared by the
local motions that explain both, and by the subspace that they span together. The steps of an update:

1. Choose key frames and the trajectories that are compared on them (:mod:`.key_frames`).
2. Fit local affine motions to random groups of neighbours (:mod:`.neighbour_sampling`, :mod:`.affine`).
3. Compute the preference kernel: do the same local motions explain two trajectories (:mod:`.similarity`)?
4. Combine it with shape interaction: do they lie in one subspace (:mod:`.similarity`)?
5. Link trajectories to superclusters, each within one body (:mod:`.linkage`).
6. Merge superclusters while boundary contrast and epipolar geometry allow it; this decides the number of
   objects (:mod:`.merging`, :mod:`.epipolar`, :mod:`.wide_baseline`).
7. Reassign single trajectories that another group's motion explains better (:mod:`.reassignment`).
8. Keep the labels of trajectories with little evidence, and assign newborn ones (:mod:`.reassignment`).
9. Keep hypotheses that have moved on their own apart while they rest (:mod:`.memory`).
"""

from bisect import bisect_left, insort
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Floats32, Ints, Labels, Slots
from ..config import FusionConfig, PixelsConfig
from ..matching import continued, largest_first
from ..partition import NO_HYPOTHESIS, Partition, Previous, Rows, SpaceSpec
from ..trajectories.window import Window
from .affine import explain
from .describe import describe
from .epipolar import EpipolarTest
from .key_frames import KeyFrames, compared_trajectories, frame_pairs
from .linkage import link, pool
from .memory import Separation
from .merging import BoundaryContrast, merge
from .neighbour_sampling import sample_members
from .reassignment import assign_newborns, label_hysteresis, reassign, vote_of_neighbours
from .similarity import Similarity, combine, preference, subspace
from .wide_baseline import WideBaselineTest

# Affinity of a pair that has not been compared: nothing is known for or against it.
_UNKNOWN_AFFINITY = 0.5


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
    """Group trajectories by motion and find the number of groups: steps 2 to 8.

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
    p, pairs = parameters, frame_pairs(frames, parameters.steps)
    members = sample_members(frames, p, np.random.default_rng(seed))  # 2
    residuals = explain(pairs, members, p.ridge, p.cap)
    kernel = preference(residuals, pairs.seen, p)  # 3
    vectors = subspace(frames, max(p.ranks), p.completion_rank, p.completion_rounds)  # 4
    similarity = combine(kernel, vectors, p)
    superclusters = link(similarity, p.supercluster_similarity)  # 5
    boundary, epipolar = BoundaryContrast(frames, similarity.value), EpipolarTest(frames)
    wide_baseline = WideBaselineTest(frames, superclusters.members(), p)
    merged = merge(superclusters, boundary, epipolar, wide_baseline, p, previous)  # 6
    _, labels = np.unique(merged[superclusters.of], return_inverse=True)
    labels, explained = reassign(frames, labels, p.ridge)  # 7
    weighted, evidence = pool(similarity, labels)
    mean = (weighted / evidence).T
    own_evidence = np.diagonal(similarity.evidence)
    labels = vote_of_neighbours(frames, own_evidence, mean, labels)  # 8
    if previous is not None:
        labels = label_hysteresis(own_evidence, explained, labels, previous)
    return Grouping(labels, _confidence(mean, labels, p.merge_similarity), similarity)


def _confidence(mean: Floats, labels: Ints, least: float) -> Floats:
    rows = np.arange(len(labels))
    own = mean[rows, labels]
    others = mean.copy()
    others[rows, labels] = 0
    rival = np.maximum(others.max(axis=1), least)
    share: Floats = np.clip(own / (own + rival), 0.0, 1.0)
    return share


class PixelMethod:
    """The method of one space in pixels.

    Parameters
    ----------
    config
        Its group `pixels` matters here.
    spec
        The space.
    """

    matching = staticmethod(largest_first)
    established = True

    def __init__(self, config: FusionConfig, spec: SpaceSpec) -> None:  # noqa: ARG002
        self._p = config.pixels
        self._stamps: list[int] = []
        self._separation = Separation(self._p.smallest)
        nobody: Slots = np.zeros(0, np.intp)
        # Of the last update: current slots, compared slots, and the similarity of these.
        self._last: tuple[Slots, Slots, Floats32] = (nobody, nobody, np.zeros((0, 0), np.float32))

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories, and the ended ones that were compared with them."""
        del self._stamps[: bisect_left(self._stamps, stamp_ns - window.span_ns)]
        compared, frames = compared_trajectories(window, current, self._stamps, self._p)  # 1
        groups = np.full(window.capacity, NO_HYPOTHESIS)
        confidence, residual = np.zeros(window.capacity), np.full(window.capacity, np.nan)
        before = previous.labels[compared]
        if len(compared) > 1:
            found = group(frames, self._p, previous=before)  # 2 to 8
            groups[compared] = self._separation.keep(frames, found.labels, before, stamp_ns)  # 9
            confidence[compared] = found.confidence
            residual[compared] = found.similarity.residual
            self._last = current, compared, found.similarity.value
        else:
            known = np.unique(before[before >= 0])
            groups[compared] = np.where(before >= 0, np.searchsorted(known, before), NO_HYPOTHESIS)
            self._last = current, compared[:0], np.zeros((0, 0), np.float32)
        count = int(groups.max(initial=-1)) + 1
        newborn = current[~np.isin(current, compared)]
        if len(newborn):
            groups[newborn], confidence[newborn] = self._newborn(window, newborn, compared, groups, previous)
        slots = np.union1d(current, compared)
        return Partition(
            slots=slots,
            groups=groups[slots],
            deciding=np.isin(slots, compared),
            confidence=confidence[current],
            position=window.positions[current, window.stop[current] - 1],
            described=describe(window, current, groups[current], residual[current], count),
        )

    def _newborn(
        self, window: Window, newborn: Slots, compared: Slots, groups: Ints, previous: Previous
    ) -> tuple[Ints, Floats]:
        """Groups of newborn trajectories and the confidence in them, at most 1/2, [n] each; step 8.

        `groups` intp [capacity] are those of the compared trajectories.
        """
        names = _provisional_names(previous.labels[compared], groups[compared])
        labelled = compared[groups[compared] != NO_HYPOTHESIS]
        known = labelled, names[groups[labelled]], previous.labels[newborn]
        labels, share = assign_newborns(window, newborn, *known, self._p.motion_weight)
        group_of = {int(name): k for k, name in enumerate(names)}
        return np.array([group_of.get(label, NO_HYPOTHESIS) for label in labels.tolist()]), share / 2

    def observed(self, window: Window, rows: Rows) -> None:  # noqa: ARG002
        """Remember the instant: key frames are chosen among them."""
        at = bisect_left(self._stamps, rows.stamp_ns)
        if at == len(self._stamps) or self._stamps[at] != rows.stamp_ns:
            insort(self._stamps, rows.stamp_ns)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Nothing to do."""

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Nothing to do."""

    def affinity(self) -> NDArray[np.float32]:
        """Similarity [n, n] of the last update's trajectories; 0.5 where not compared."""
        current, compared, value = self._last
        affinity = np.full((len(current), len(current)), _UNKNOWN_AFFINITY, np.float32)
        _, rows, index = np.intersect1d(current, compared, assume_unique=True, return_indices=True)
        # Rounding and the floors of its factors can lift a similarity above 1.
        affinity[np.ix_(rows, rows)] = np.minimum(value[np.ix_(index, index)], np.float32(1))
        np.fill_diagonal(affinity, 1.0)
        return affinity

    def state(self) -> dict[str, Any]:
        """Which hypotheses are separate; all else that is kept follows from the window."""
        return {"separate": self._separation.state()}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Read the instants from the window."""
        self._separation.load(state.get("separate", []))
        series = [window.series(slot).times for slot in window.slots().tolist()]
        self._stamps = np.unique(np.concatenate([np.zeros(0, np.int64), *series])).tolist()


def _provisional_names(before: Labels, groups: Ints) -> Labels:
    """Name of each group for votes, int64 [K]: the hypothesis it continues, or one above all others."""
    count = int(groups.max(initial=-1)) + 1
    names = np.arange(count) + int(before.max(initial=0)) + 1
    for k, hypothesis in continued(before, groups, count, largest_first).items():
        names[k] = hypothesis
    return names
