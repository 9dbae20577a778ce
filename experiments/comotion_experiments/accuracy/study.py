"""One run of one case: messages -> scores over time, and correctness of the assignments."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_schemas import UNDETERMINED, HypothesisUpdate

from ..offline import run_offline
from ..trace import objects_of, rightly_assigned
from .cases import Case

PERIOD = 1 / 3
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """Results of a run.

    `seconds`, `nmi` float64 [updates]; `confidence` float64 [n] and `right` bool [n] of
    every assignment of a track with known object.
    """

    seconds: Array
    nmi: Array
    switches: float
    confidence: Array
    right: NDArray[np.bool_]

    @property
    def mean(self) -> float:
        """Mean NMI over all updates."""
        return float(np.nanmean(self.nmi))


@dataclass
class _Collector:
    truth: Truth
    confidence: list[Array] = field(default_factory=list)
    right: list[NDArray[np.bool_]] = field(default_factory=list)

    def add(self, update: HypothesisUpdate, _: Score) -> None:
        objects = objects_of(update, self.truth)
        labels = update.track_hypothesis
        known = (objects >= 0) & (labels != UNDETERMINED)
        if known.any():
            self.confidence.append(update.track_confidence[known].astype(np.float64))
            self.right.append(rightly_assigned(labels[known], objects[known]))


def run_case(case: Case, config: FusionConfig, seed: int, duration: float | None = None) -> Outcome:
    """Run a case through the core."""
    truth = Truth()
    collector = _Collector(truth)
    run = run_offline(
        case.open(seed),
        config,
        truth=truth,
        period=PERIOD,
        duration=case.duration if duration is None else duration,
        on_update=collector.add,
    )
    return Outcome(
        seconds=run.seconds,
        nmi=run.nmi,
        switches=run.summary.switches_per_100,
        confidence=np.concatenate([*collector.confidence, np.zeros(0)]),
        right=np.concatenate([*collector.right, np.zeros(0, np.bool_)]),
    )
