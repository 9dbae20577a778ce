"""What a run said at each update, beside the truth: the input of every metric."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion_clients.metrics import Truth, labels_of, score_labels
from comotion_clients.scoring import Observed
from comotion_schemas import UNDETERMINED, HypothesisUpdate

from ..inputs import Arrived
from .apart import Apart
from .observe import EPOCH_NS

UNEVENTFUL = frozenset({"joined", "released"})
"""Kinds of events about joints between hypotheses, not of the set of hypotheses."""


@dataclass(frozen=True)
class Moment:
    """One update over the tracks observed at its stamp."""

    t: float  # s of the scene
    labels: NDArray[np.int64]  # [N], hypothesis id; UNDETERMINED for a track that has none
    bodies: NDArray[np.int64]  # [N], index of the true body
    confirmed: frozenset[int]  # ids of the confirmed hypotheses among the labels
    events: tuple[str, ...]  # kinds of the events of this update
    nmi: float  # against the true bodies
    nmi_apart: float  # with bodies as one that nothing has separated yet


@dataclass
class Watcher:
    """Collects the moments of a run; feed it batches before the core sees them, and every update."""

    truth: Truth
    apart: Apart
    moments: list[Moment] = field(default_factory=list)
    _listed: set[tuple[int, str, int, tuple[int, ...]]] = field(default_factory=set)
    _observed: Observed = field(default_factory=Observed)

    def passing(self, batches: Iterable[Arrived]) -> Iterator[Arrived]:
        """Hand batches on, and note what they observe."""
        for arrived in batches:
            self._observed.add(arrived.batch)
            yield arrived

    def add(self, update: HypothesisUpdate) -> None:
        """Take in an update."""
        t = (update.stamp_ns - EPOCH_NS) / 1e9
        labels, bodies = labels_of(update, self.truth, self._observed.at(update.stamp_ns))
        together = self.apart.components(t)[bodies].astype(np.int32)
        confirmed = {h.id for h in update.hypotheses if h.confirmed}
        # Each event is repeated for some seconds.
        listed = {(e.stamp_ns, e.kind, e.hypothesis, tuple(e.others)) for e in update.events}
        new = sorted(listed - self._listed)
        self._listed |= listed
        self.moments.append(
            Moment(
                t=t,
                labels=labels,
                bodies=bodies.astype(np.int64),
                confirmed=frozenset(labels[labels != UNDETERMINED].tolist()) & confirmed,
                events=tuple(kind for _, kind, _, _ in new if kind not in UNEVENTFUL),
                nmi=score_labels(labels, bodies, 0).nmi,
                nmi_apart=score_labels(labels, together, 0).nmi,
            )
        )
