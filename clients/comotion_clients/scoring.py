"""Scores the updates of a run by its batches and truth, and summarises the scores. Pure."""

import bisect
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import HypothesisUpdate, Message, ObservationBatch, TruthBatch
from comotion_schemas.types import Unit

from .metrics import Score, SourceKey, Truth, label_switches, labelled, score_labels
from .tracking import Tracking

SETTLE_S = 0.15
"""A live update is scored this long after its arrival: its batches have then arrived as well."""
TRACK_TIMEOUT_S = 0.5
"""A track is outdated after this time or 3 periods of its source (docs/protocol.md)."""
_TIMEOUT_PERIODS = 3
_BATCHES_KEPT = 4096  # per source: 40 s at 100 Hz, should no update arrive


@dataclass(frozen=True, slots=True)
class _Batch:
    """The rows of one batch of a source, with its first acquisition time."""

    first_ns: int
    session: str
    ids: NDArray[np.uint64]
    stamps_ns: NDArray[np.int64] | None


@dataclass(frozen=True, slots=True)
class SpaceRef:
    """The coordinate space of a source's features."""

    name: str
    unit: Unit
    dim: int


UNKNOWN = "unknown"
"""Name of the space of a source without batches and hypotheses."""


def spaces_of(
    update: HypothesisUpdate, published: Mapping[str, SpaceRef] = MappingProxyType({})
) -> list[SpaceRef]:
    """Determine the coordinate space of every source of an update.

    Parameters
    ----------
    update
        An update.
    published
        Space of each source, from its batches. For other sources the space is that of the hypotheses of
        its tracks, with the unit m in 3-D and px in 2-D.
    """
    return [
        published.get(source.name) or _space_of_tracks(update, number)
        for number, source in enumerate(update.sources)
    ]


def _space_of_tracks(update: HypothesisUpdate, source: int) -> SpaceRef:
    rows = update.track_source == source
    spaces = {h.id: h.space for h in update.hypotheses}
    names = (spaces[h] for h in update.track_hypothesis[rows].tolist() if h in spaces)
    flat = bool(np.isnan(update.track_position[rows, 2]).any())
    return SpaceRef(next(names, UNKNOWN), "px" if flat else "m", 2 if flat else 3)


class Observed:
    """Determines which tracks are observed at a given time, from the batches of all sources.

    A track is observed at time W if it is in the newest batch of its source at W and this batch is at
    most 0.5 s, or three periods of the source if longer, old. Of a batch with several instants, those
    up to W count. :attr:`spaces` maps each source to its coordinate space.
    """

    def __init__(self) -> None:
        self.spaces: dict[str, SpaceRef] = {}
        self._sources: dict[str, list[_Batch]] = {}

    def add(self, batch: ObservationBatch) -> None:
        """Add a batch; batches may come in any order."""
        self.spaces[batch.source] = SpaceRef(batch.space, batch.unit, batch.dim)
        stamps = batch.stamps_ns if batch.stamps_ns is not None and len(batch.ids) else None
        first = batch.stamp_ns if stamps is None else int(stamps.min())
        batches = self._sources.setdefault(batch.source, [])
        bisect.insort(batches, _Batch(first, batch.session, batch.ids, stamps), key=lambda s: s.first_ns)
        if len(batches) > _BATCHES_KEPT:
            del batches[0]

    def at(self, stamp_ns: int) -> dict[SourceKey, NDArray[np.uint64]]:
        """Return the feature ids uint64 [N] observed at a time, by source.

        Times must not decrease from call to call: older batches are discarded.
        """
        tracks: dict[SourceKey, NDArray[np.uint64]] = {}
        for source, batches in self._sources.items():
            count = bisect.bisect_right(batches, stamp_ns, key=lambda s: s.first_ns)
            if not count:
                continue
            newest = batches[count - 1]
            period_ns = newest.first_ns - batches[count - 2].first_ns if count > 1 else 0
            if stamp_ns - newest.first_ns <= max(TRACK_TIMEOUT_S * 1e9, _TIMEOUT_PERIODS * period_ns):
                rows = slice(None) if newest.stamps_ns is None else newest.stamps_ns <= stamp_ns
                tracks[source, newest.session] = np.unique(newest.ids[rows])
            # Keep the batch before as well, to determine the period.
            del batches[: count - 2 if count > 2 else 0]
        return tracks


@dataclass(frozen=True)
class Summary:
    """Summary of the scores of a run."""

    # Number of updates; number of those with at least one scored track.
    updates: int
    scored: int
    # Over the scored updates; NaN without truth.
    mean_nmi: float
    final_nmi: float
    # Over the scored updates; NaN without truth.
    mean_misclassification: float
    final_misclassification: float
    # Hypotheses and true objects among the scored tracks; without truth all hypotheses.
    mean_hypotheses: float
    mean_objects: float
    # Tracks whose hypothesis id changed between consecutive updates, per 100 common tracks.
    switches_per_100: float
    # Of hypotheses as tracked objects (:mod:`.tracking`), over the scored updates; NaN without truth.
    hota: float
    idf1: float
    id_switches: float


class Scoring:
    """Scores a run: its truth, what is observed, and its updates one by one.

    Attributes
    ----------
    truth, observed
        From the messages so far.
    scores
        One per update, in order.
    last
        The update that was scored last; there is none before.
    """

    last: HypothesisUpdate

    def __init__(self, truth: Truth | None = None) -> None:
        self.truth, self.observed = truth or Truth(), Observed()
        self.scores: list[Score] = []
        self._waiting: list[tuple[float, HypothesisUpdate]] = []
        self._newest_ns: int | None = None
        self._switched, self._common = 0, 0
        self._tracking = Tracking()
        self._listed: list[int] = []

    def add(self, message: Message, arrived: float = 0.0) -> None:
        """Add a message of any kind; `arrived` in s of one clock. An update then waits until it is due."""
        match message:
            case TruthBatch():
                self.truth.add(message)
            case ObservationBatch():
                self.observed.add(message)
            case HypothesisUpdate():
                self._waiting.append((arrived, message))

    def due(self, now: float) -> Iterator[HypothesisUpdate]:
        """Yield the updates whose batches have arrived; all of them for infinity.

        After all sources have ended, updates repeat their stamp: scoring them would overweight the last one.
        """
        while self._waiting and now - self._waiting[0][0] >= SETTLE_S:
            update = self._waiting.pop(0)[1]
            if update.stamp_ns != self._newest_ns:
                self._newest_ns = update.stamp_ns
                yield update

    def score(self, update: HypothesisUpdate) -> Score:
        """Score an update against the truth so far, over the tracks observed at its stamp."""
        labels, objects = labelled(update, self.truth, self.observed.at(update.stamp_ns))
        score = score_labels(labels, objects, update.stamp_ns)
        self.scores.append(score)
        if score.scored:
            self._tracking.add(labels, objects)
        self._listed.append(sum(not h.absent for h in update.hypotheses))
        if len(self.scores) > 1:
            switched, common = label_switches(self.last, update)
            self._switched, self._common = self._switched + switched, self._common + common
        self.last = update
        return score

    @property
    def summary(self) -> Summary:
        """Summary of the scores so far."""
        scored, tracked = [score for score in self.scores if score.scored], self._tracking.figures()
        return Summary(
            updates=len(self.scores),
            scored=len(scored),
            mean_nmi=self.mean_nmi,
            final_nmi=scored[-1].nmi if scored else math.nan,
            mean_misclassification=_mean([s.misclassification for s in scored]),
            final_misclassification=scored[-1].misclassification if scored else math.nan,
            mean_hypotheses=_mean([s.hypotheses for s in scored] if scored else self._listed),
            mean_objects=_mean([s.objects for s in scored]),
            switches_per_100=100.0 * self._switched / max(self._common, 1),
            hota=tracked.hota,
            idf1=tracked.idf1,
            id_switches=tracked.id_switches,
        )

    @property
    def mean_nmi(self) -> float:
        """Over the scored updates so far; NaN without any."""
        return _mean([score.nmi for score in self.scores if score.scored])


def _mean(values: list[Any]) -> float:
    return math.fsum(values) / len(values) if values else math.nan
