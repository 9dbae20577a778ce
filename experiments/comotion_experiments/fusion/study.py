"""One run of the fusion experiment: variant and seed -> scores of every update."""

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion_clients.metrics import Score, Truth, score_update, tracks_of
from comotion_clients.scoring import Observed
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch
from comotion_sources.workcell import Scene

from ..offline import Message, run_offline
from ..trace import objects_of
from .recording import Recording
from .setup import CAMERA_A, Variant
from .surface import Surfaces

Series = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """Scores of one variant of one seed of one scene, one per update.

    Attributes
    ----------
    t
        float64 [U], event time of the updates in seconds.
    nmi
        NMI over all features of the variant.
    nmi_a
        NMI over camera A's features alone; NaN where there are none.
    surface
        Share of the moving objects' surface covered by features, mean over objects.
    ids
        Object number -> hypothesis that holds most of its features from sources other than camera A,
        int64 [U], -1 where there are none.
    """

    t: Series
    nmi: Series
    nmi_a: Series
    surface: Series
    ids: dict[int, NDArray[np.int64]]

    def mean(self, series: Series, start: float = 0.0, stop: float = np.inf) -> float:
        """Mean of a series over start <= t < stop, NaN left out; NaN if there is nothing."""
        chosen = series[(self.t >= start) & (self.t < stop)]
        chosen = chosen[np.isfinite(chosen)]
        return float(chosen.mean()) if len(chosen) else float("nan")

    def kept(self, start: float, stop: float) -> float:
        """Share of (object, update) in start..stop whose hypothesis is that of just before `start`.

        Objects whose hypothesis at the start also held another object, because the two had not moved
        apart yet, do not count: splitting them later must give one a new id.
        """
        before = np.flatnonzero(self.t < start)
        during = (self.t >= start) & (self.t < stop)
        if not len(before) or not during.any():
            return float("nan")
        first = {number: int(ids[before[-1]]) for number, ids in self.ids.items()}
        shares = []
        for number, ids in self.ids.items():
            alone = list(first.values()).count(first[number]) == 1
            seen = ids[during][ids[during] >= 0]
            if first[number] >= 0 and alone and len(seen):
                shares.append(np.mean(seen == first[number]))
        return float(np.mean(shares)) if shares else float("nan")


@dataclass
class _Scorer:
    truth: Truth
    surfaces: Surfaces
    observed: Observed = field(default_factory=Observed)
    rows: list[tuple[float, float, float, float]] = field(default_factory=list)
    ids: list[dict[int, int]] = field(default_factory=list)

    def add(self, update: HypothesisUpdate, score: Score) -> None:
        t = update.stamp_ns * 1e-9
        seen = self.observed.at(update.stamp_ns)
        of_a = {key: ids for key, ids in seen.items() if key[0] == CAMERA_A}
        nmi_a = score_update(update, self.truth, of_a).nmi if of_a else float("nan")
        self.rows.append((t, score.nmi, nmi_a, self._surface(update, t)))
        self.ids.append(self._main_hypotheses(update))

    def _surface(self, update: HypothesisUpdate, t: float) -> float:
        objects = objects_of(update, self.truth)
        shares = self.surfaces.covered(t, update.track_position.astype(np.float64), objects)
        return float(np.mean(list(shares.values())))

    def _main_hypotheses(self, update: HypothesisUpdate) -> dict[int, int]:
        """Hypothesis that holds most of each object's features of sources other than camera A."""
        votes: dict[int, list[int]] = {}
        for key, table in tracks_of(update).items():
            if key[0] == CAMERA_A:
                continue
            features = np.array(list(table), np.uint64)
            for number, hypothesis in zip(self.truth.objects(key, features), table.values(), strict=True):
                if number > 0 and hypothesis != UNDETERMINED:
                    votes.setdefault(int(number), []).append(hypothesis)
        return {number: int(np.bincount(given).argmax()) for number, given in votes.items()}


def run_variant(
    recording: Recording,
    scene: Scene,
    variant: Variant,
    config: FusionConfig,
    *,
    covered: bool,
    period: float = 1 / 3,
) -> Outcome:
    """Fuse the sources of a variant and score every update.

    Parameters
    ----------
    recording, scene
        What the sources saw, and the truth.
    variant
        Which sources.
    config
        Parameters of the core.
    covered
        Use what camera A saw with its lens covered for a while.
    period
        Seconds between updates.
    """
    streams = [recording.of(source, covered=covered) for source in variant.sources]
    scorer = _Scorer(Truth(), Surfaces(scene))
    run_offline(
        in_time_order(streams),
        config,
        truth=scorer.truth,
        observed=scorer.observed,
        period=period,
        on_update=scorer.add,
    )
    t, nmi, nmi_a, surface = np.array(scorer.rows).T
    numbers = sorted({number for ids in scorer.ids for number in ids})
    ids = {n: np.array([row.get(n, -1) for row in scorer.ids], np.int64) for n in numbers}
    return Outcome(t, nmi, nmi_a, surface, ids)


def in_time_order(streams: Sequence[Sequence[Message]]) -> Iterator[Message]:
    """Merge the messages of several sources by stamp; a truth goes with the batch that follows it."""

    def stamped(index: int, messages: Sequence[Message]) -> Iterator[tuple[int, int, int, Message]]:
        stamp = 0
        for number, message in enumerate(messages):
            following = message if isinstance(message, ObservationBatch) else messages[number + 1]
            stamp = following.stamp_ns if isinstance(following, ObservationBatch) else stamp
            yield stamp, index, number, message

    merged = heapq.merge(*(stamped(i, m) for i, m in enumerate(streams)), key=lambda item: item[:3])
    return (message for *_, message in merged)
