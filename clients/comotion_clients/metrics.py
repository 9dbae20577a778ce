"""NMI, misclassification rate and label switches of a partition or an update, against the truth. Pure."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.special import entr

from comotion_schemas import UNDETERMINED, HypothesisUpdate, TruthBatch

Labels: TypeAlias = NDArray[np.integer[Any]]
SourceKey: TypeAlias = tuple[str, str]
"""(name, session) of a source: what its feature ids belong to."""
TrackIds: TypeAlias = Mapping[SourceKey, NDArray[np.uint64]]
"""Feature ids per source; the ids of one source are unique."""


def nmi(labels: Labels, truth: Labels) -> float:
    """Normalised mutual information 2 I(C;G) / (H(C) + H(G)), equation (4.1) of the thesis.

    Parameters
    ----------
    labels, truth
        Integers [N], the estimated and the true partition. Every value is a cluster; see
        :func:`isolate` for tracks without a hypothesis.

    Returns
    -------
    A number in 0..1; 1 if both partitions have a single cluster; NaN without tracks.
    """
    counts = _crosstab(labels, truth)
    if not counts.size:
        return float("nan")
    joint = counts / counts.sum()
    p_c, p_g = joint.sum(axis=1), joint.sum(axis=0)
    k, g = np.nonzero(counts)
    if len(k) == len(p_c) == len(p_g):
        # Equal partitions, including a single cluster: exactly 1 without rounding errors.
        return 1.0
    information = float(np.sum(joint[k, g] * np.log(joint[k, g] / (p_c[k] * p_g[g]))))
    return min(max(2.0 * information / float(entr(p_c).sum() + entr(p_g).sum()), 0.0), 1.0)


def misclassification(labels: Labels, truth: Labels) -> float:
    """Share of tracks that are wrong under the best one-to-one assignment of clusters to true objects.

    The assignment maximises the number of right tracks (Hungarian method). All members of a cluster
    without an object are wrong.

    Parameters
    ----------
    labels, truth
        Integers [N], the estimated and the true partition.

    Returns
    -------
    A number in 0..1; NaN without tracks.
    """
    counts = _crosstab(labels, truth)
    if not counts.size:
        return float("nan")
    rows, columns = linear_sum_assignment(counts, maximize=True)
    return float(1.0 - counts[rows, columns].sum() / counts.sum())


def _crosstab(labels: Labels, truth: Labels) -> NDArray[np.intp]:
    """Count the tracks of each cluster in each object, [clusters, objects]: scipy.stats is slow to import."""
    (clusters, row), (objects, column) = (np.unique(of, return_inverse=True) for of in (labels, truth))
    counts = np.zeros((len(clusters), len(objects)), np.intp)
    np.add.at(counts, (row, column), 1)
    return counts


def isolate(labels: Labels, marker: int = UNDETERMINED) -> NDArray[np.int64]:
    """Put every track with the label `marker` into a separate cluster.

    Parameters
    ----------
    labels
        Integers [N].
    marker
        The label of tracks without a hypothesis.

    Returns
    -------
    int64 [N] in 0..K-1, where K includes the singletons.
    """
    alone = np.asarray(labels) == marker
    listed, inverse = np.unique(np.asarray(labels)[~alone], return_inverse=True)
    clusters = np.empty(len(alone), np.int64)
    clusters[~alone] = inverse
    clusters[alone] = len(listed) + np.arange(np.count_nonzero(alone))
    return clusters


class Truth:
    """The true object of each feature, accumulated from truth batches."""

    def __init__(self, batches: Iterable[TruthBatch] = ()) -> None:
        self._objects: dict[SourceKey, dict[int, int]] = {}
        self.names: dict[int, str] = {}
        for batch in batches:
            self.add(batch)

    def add(self, batch: TruthBatch) -> None:
        """Add a batch; a later value of an id replaces an earlier one."""
        table = self._objects.setdefault((batch.source, batch.session), {})
        table.update(zip(batch.ids.tolist(), batch.objects.tolist(), strict=True))
        self.names.update((int(number), name) for number, name in batch.names.items())

    def __len__(self) -> int:
        """Number of features with truth, including ambiguous ones."""
        return sum(len(table) for table in self._objects.values())

    def objects(self, source: SourceKey, ids: NDArray[np.uint64]) -> NDArray[np.int32]:
        """Look up the object numbers of features uint64 [N]: int32 [N], -1 if ambiguous or unknown."""
        table = self._objects.get(source, {})
        return np.fromiter((table.get(i, -1) for i in ids.tolist()), np.int32, len(ids))


@dataclass(frozen=True)
class Score:
    """Score of one update."""

    stamp_ns: int  # event time of the update
    # Over the scored tracks; NaN without any.
    nmi: float
    misclassification: float
    # Number of hypotheses and of true objects among the scored tracks.
    hypotheses: int
    objects: int
    # Number of tracks with truth; number of these that are undetermined or not in the update.
    scored: int
    singletons: int


def tracks_of(update: HypothesisUpdate) -> dict[SourceKey, dict[int, int]]:
    """Map the tracks of an update: (name, session) -> feature id -> hypothesis id."""
    return {(ref.name, ref.session): update.hypotheses_of(ref.name, ref.session) for ref in update.sources}


def bodies_of(update: HypothesisUpdate) -> dict[int, int]:
    """Map each linked hypothesis to its body: the lowest id among the linked hypotheses.

    Two hypotheses of one space are linked only through hypotheses of other spaces.
    """
    lowest = {h.id: min([h.id, *h.linked]) for h in update.hypotheses if h.linked}
    return {hypothesis: min(lowest.get(low, low), low) for hypothesis, low in lowest.items()}


def score_update(update: HypothesisUpdate, truth: Truth, observed: TrackIds | None = None) -> Score:
    """Score one update; linked hypotheses of different spaces count as one.

    Parameters
    ----------
    update
        An update of the service or the core.
    truth
        True objects; tracks that are ambiguous (-1) or without truth are not scored.
    observed
        The tracks observed at the stamp of the update: these are scored, and a track that is
        undetermined or not in the update is a singleton. None: the tracks of the update.
    """
    return score_labels(*labelled(update, truth, observed), update.stamp_ns)


def labelled(
    update: HypothesisUpdate, truth: Truth, observed: TrackIds | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """As :func:`labels_of`, where linked hypotheses of different spaces have one label."""
    labels, objects = labels_of(update, truth, observed)
    bodies = bodies_of(update)
    if bodies:
        labels = np.array([bodies.get(label, label) for label in labels.tolist()], np.int64)
    return labels, objects


def labels_of(
    update: HypothesisUpdate, truth: Truth, observed: TrackIds | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Hypothesis, int64 [N], and true object, int32 [N], of every track, in the order of `observed`.

    The arguments are those of :func:`score_update`; a track that is not in the update is undetermined.
    """
    listed = tracks_of(update)
    if observed is None:
        observed = {key: np.array(list(table), np.uint64) for key, table in listed.items()}
    labels, objects = [np.empty(0, np.int64)], [np.empty(0, np.int32)]
    for key, ids in observed.items():
        table = listed.get(key, {})
        labels.append(np.array([table.get(i, UNDETERMINED) for i in ids.tolist()], np.int64))
        objects.append(truth.objects(key, ids))
    return np.concatenate(labels), np.concatenate(objects)


def score_labels(labels: NDArray[np.int64], objects: NDArray[np.int32], stamp_ns: int) -> Score:
    """Score labels against the truth.

    Parameters
    ----------
    labels
        int64 [N], hypothesis ids; UNDETERMINED is a singleton.
    objects
        int32 [N], true objects; tracks with -1 are left out.
    stamp_ns
        Event time of the score.
    """
    scored = objects >= 0
    labels, objects = labels[scored], objects[scored]
    clusters = isolate(labels)
    determined = labels[labels != UNDETERMINED]
    return Score(
        stamp_ns=stamp_ns,
        nmi=nmi(clusters, objects),
        misclassification=misclassification(clusters, objects),
        hypotheses=len(np.unique(determined)),
        objects=len(np.unique(objects)),
        scored=len(labels),
        singletons=len(labels) - len(determined),
    )


def label_switches(previous: HypothesisUpdate, current: HypothesisUpdate) -> tuple[int, int]:
    """Count the tracks whose hypothesis id differs between two updates, and those that both have.

    A change from or to undetermined counts as well.
    """
    old_of = tracks_of(previous)
    pairs = [
        (old_of[key][feature], new)
        for key, table in tracks_of(current).items()
        for feature, new in table.items()
        if feature in old_of.get(key, {})
    ]
    return sum(old != new for old, new in pairs), len(pairs)
