"""How good a grouping is: NMI, misclassification rate and label switches.

Pure functions on arrays and messages; no transport, no clock.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from comotion_schemas import UNDETERMINED, HypothesisUpdate, TruthBatch

Labels: TypeAlias = NDArray[np.integer[Any]]
SourceKey: TypeAlias = tuple[str, str]
"""(name, session) of a source: what its feature ids belong to."""
TrackIds: TypeAlias = Mapping[SourceKey, NDArray[np.uint64]]
"""Feature ids per source; the ids of one source are unique."""


def contingency(labels: Labels, truth: Labels) -> NDArray[np.int64]:
    """Count the members that each pair of clusters shares.

    Parameters
    ----------
    labels, truth
        Integers [N]: two partitions of the same N tracks.

    Returns
    -------
    int64 [K, L], one row per cluster of `labels` and one column per cluster of `truth`, in sorted order.
    """
    if np.shape(labels) != np.shape(truth) or np.ndim(labels) != 1:
        raise ValueError(f"two vectors of one length expected, got {np.shape(labels)} and {np.shape(truth)}")
    rows, row = np.unique(labels, return_inverse=True)
    columns, column = np.unique(truth, return_inverse=True)
    flat = np.bincount(row * len(columns) + column, minlength=len(rows) * len(columns))
    return flat.reshape(len(rows), len(columns)).astype(np.int64)


def nmi(labels: Labels, truth: Labels) -> float:
    """Normalised mutual information 2I(C;G) / (H(C) + H(G)), equation (4.1) of the thesis.

    Parameters
    ----------
    labels, truth
        Integers [N], the obtained and the true partition. Every value is a cluster; see
        :func:`isolate` for tracks that belong to none.

    Returns
    -------
    A number in 0..1; 1 when both partitions are one single cluster; NaN without tracks.
    """
    counts = contingency(labels, truth)
    if not counts.size:
        return float("nan")
    joint = counts / counts.sum()
    p_c, p_g = joint.sum(axis=1), joint.sum(axis=0)
    k, g = np.nonzero(counts)
    if len(k) == len(p_c) == len(p_g):
        # The same partition twice, a single cluster included: exactly 1, whatever rounding does.
        return 1.0
    information = float(np.sum(joint[k, g] * np.log(joint[k, g] / (p_c[k] * p_g[g]))))
    return min(max(2.0 * information / (_entropy(p_c) + _entropy(p_g)), 0.0), 1.0)


def _entropy(p: NDArray[np.float64]) -> float:
    return float(-np.sum(p * np.log(p)))


def misclassification(labels: Labels, truth: Labels) -> float:
    """Share of tracks that are wrong under the best one-to-one match of clusters to true objects.

    The members of clusters beyond the number of objects are all errors. The match maximises the
    number of right tracks (Hungarian method).

    Parameters
    ----------
    labels, truth
        Integers [N].

    Returns
    -------
    A number in 0..1; NaN without tracks.
    """
    counts = contingency(labels, truth)
    if not counts.size:
        return float("nan")
    rows, columns = linear_sum_assignment(counts, maximize=True)
    return float(1.0 - counts[rows, columns].sum() / counts.sum())


def isolate(labels: Labels, marker: int = UNDETERMINED) -> NDArray[np.int64]:
    """Give every track that carries `marker` a cluster of its own.

    Parameters
    ----------
    labels
        Integers [N].
    marker
        The label that means "belongs to no hypothesis".

    Returns
    -------
    int64 [N] in 0..K-1, K clusters with the singletons.
    """
    alone = np.asarray(labels) == marker
    known, inverse = np.unique(np.asarray(labels)[~alone], return_inverse=True)
    clusters = np.empty(len(alone), np.int64)
    clusters[~alone] = inverse
    clusters[alone] = len(known) + np.arange(np.count_nonzero(alone))
    return clusters


class Truth:
    """What the sources said about the true object of each feature; batches add up."""

    def __init__(self, batches: Iterable[TruthBatch] = ()) -> None:
        self._objects: dict[SourceKey, dict[int, int]] = {}
        self.names: dict[int, str] = {}
        for batch in batches:
            self.add(batch)

    def add(self, batch: TruthBatch) -> None:
        """Take in a batch; the last value of an id holds."""
        table = self._objects.setdefault((batch.source, batch.session), {})
        table.update(zip(batch.ids.tolist(), batch.objects.tolist(), strict=True))
        self.names.update((int(number), name) for number, name in batch.names.items())

    def __len__(self) -> int:
        """Count the features with a statement, ambiguous ones included."""
        return sum(len(table) for table in self._objects.values())

    def objects(self, source: SourceKey, ids: NDArray[np.uint64]) -> NDArray[np.int32]:
        """Look up object numbers: int32 [N], -1 where ambiguous or not stated."""
        table = self._objects.get(source, {})
        return np.fromiter((table.get(i, -1) for i in ids.tolist()), np.int32, len(ids))


@dataclass(frozen=True)
class Score:
    """One update against the truth.

    Attributes
    ----------
    stamp_ns
        Event time of the update.
    nmi, misclassification
        Over the scored tracks; NaN where there is none.
    hypotheses, objects
        Distinct hypotheses and distinct true objects among the scored tracks.
    scored, singletons
        Tracks with a truth; those of them that are undetermined or not listed by the update.
    """

    stamp_ns: int
    nmi: float
    misclassification: float
    hypotheses: int
    objects: int
    scored: int
    singletons: int


def tracks_of(update: HypothesisUpdate) -> dict[SourceKey, dict[int, int]]:
    """Hypothesis id of every listed track: (name, session) -> feature id -> hypothesis id."""
    tables: list[dict[int, int]] = [{} for _ in update.sources]
    rows = zip(
        update.track_source.tolist(), update.track_id.tolist(), update.track_hypothesis.tolist(), strict=True
    )
    for source, feature, hypothesis in rows:
        tables[source][feature] = hypothesis
    return {(s.name, s.session): table for s, table in zip(update.sources, tables, strict=True)}


def bodies_of(update: HypothesisUpdate) -> dict[int, int]:
    """Body of each hypothesis that is linked: the lowest id among those that are one, itself included.

    Hypotheses of one space that are one body name each other only through those of other spaces.
    """
    lowest = {h.id: min([h.id, *h.linked]) for h in update.hypotheses if h.linked}
    return {one: min(lowest.get(low, low), low) for one, low in lowest.items()}


def score_update(update: HypothesisUpdate, truth: Truth, observed: TrackIds | None = None) -> Score:
    """Score one update; linked hypotheses of different spaces count as one.

    Parameters
    ----------
    update
        What the service, or the core, said.
    truth
        True objects; tracks that are ambiguous (-1) or without a statement are never scored.
    observed
        The tracks that are observed at the update's stamp: these are scored, and one that the
        update leaves out, or calls undetermined, is a singleton. None: the tracks of the update.
    """
    listed, bodies = tracks_of(update), bodies_of(update)
    if observed is None:
        observed = {key: np.array(list(table), np.uint64) for key, table in listed.items()}
    labels, objects = [np.empty(0, np.int64)], [np.empty(0, np.int32)]
    for key, ids in observed.items():
        table = listed.get(key, {})
        ours = (table.get(i, UNDETERMINED) for i in ids.tolist())
        labels.append(np.fromiter((bodies.get(one, one) for one in ours), np.int64, len(ids)))
        objects.append(truth.objects(key, ids))
    return score_labels(np.concatenate(labels), np.concatenate(objects), update.stamp_ns)


def score_labels(labels: NDArray[np.int64], objects: NDArray[np.int32], stamp_ns: int) -> Score:
    """Score hypothesis ids int64 [N] (UNDETERMINED: a singleton) against objects int32 [N] (-1: left out)."""
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


@dataclass(frozen=True)
class Switches:
    """Label switches among the tracks that two updates share; sums of updates add up."""

    switched: int = 0
    common: int = 0

    def __add__(self, other: "Switches") -> "Switches":
        return Switches(self.switched + other.switched, self.common + other.common)

    @property
    def per_100(self) -> float:
        """Switches per 100 tracks present in both updates; 0 without such tracks."""
        return 100.0 * self.switched / self.common if self.common else 0.0


def label_switches(previous: HypothesisUpdate, current: HypothesisUpdate) -> Switches:
    """Count the tracks whose hypothesis id differs from the previous update's.

    Becoming undetermined, or ceasing to be, is a difference as well.
    """
    before, switched, common = tracks_of(previous), 0, 0
    for key, table in tracks_of(current).items():
        old = before.get(key, {})
        shared = [(old[feature], new) for feature, new in table.items() if feature in old]
        common += len(shared)
        switched += sum(was != now for was, now in shared)
    return Switches(switched, common)
