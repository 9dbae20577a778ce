"""Runs scenes for figures: scores over time, and detailed views of some moments."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_clients.scoring import SpaceRef
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch

from ..inputs import Message
from ..offline import Run, run_offline
from ..trace import Moment, moment_of, trails_of

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """The details of one update."""

    t: float  # s since the first observation
    moment: Moment
    trails: list[NDArray[np.float32]]  # positions of each track in the last seconds, [steps, dim]
    affinity: NDArray[np.float32]  # [N, N], rows sorted by object; empty unless requested
    affinity_objects: NDArray[np.int64]  # object of each row, [N]


@dataclass(frozen=True)
class SeedRun:
    """One seed of one scene through the core."""

    run: Run
    moments: list[Moment]  # the tracks of every update
    views: list[View]  # those that were requested, in order

    @property
    def names(self) -> dict[int, str]:
        """Names of the objects by their numbers."""
        return self.run.truth.names

    def votes(self) -> Counter[tuple[int, int]]:
        """(hypothesis, object) -> tracks times updates that they share."""
        votes = Counter[tuple[int, int]]()
        for moment in self.moments:
            votes.update(zip(moment.hypotheses.tolist(), moment.objects.tolist(), strict=True))
        return votes

    def main_of(self, name: str) -> NDArray[np.int64]:
        """Hypothesis that holds most of an object's tracks at every update, int64 [U]; -1 where none does."""
        numbers = [number for number, other in self.names.items() if other == name]
        return np.array([main_hypothesis(m.hypotheses[np.isin(m.objects, numbers)]) for m in self.moments])


def main_hypothesis(labels: NDArray[np.int64]) -> int:
    """The most frequent hypothesis, of two as frequent the smaller id; -1 if that is none."""
    ids, counts = np.unique(labels, return_counts=True)
    main = int(ids[counts.argmax()]) if len(ids) else UNDETERMINED
    return -1 if main == UNDETERMINED else main


@dataclass(frozen=True)
class SceneRuns:
    """The seeds of one scene, run with one set of parameters."""

    seeds: list[SeedRun]

    @property
    def t(self) -> Floats:
        """Times that all seeds have, float64 [U]."""
        return min((seed.run.seconds for seed in self.seeds), key=len)

    @property
    def nmi(self) -> Floats:
        """float64 [seeds, U]."""
        return np.array([seed.run.nmi[: len(self.t)] for seed in self.seeds])

    def nearest(self, t: float) -> int:
        """Number of the update nearest to a time."""
        return int(np.abs(self.t - t).argmin())

    def mean_nmi(self) -> Floats:
        """Mean over time of every seed, float64 [seeds]."""
        return np.array([np.nanmean(seed.run.nmi) for seed in self.seeds])

    def spread(self) -> tuple[Any, Any]:
        """Mean and standard deviation of NMI over seeds [U], masked where no seed has a value."""
        scored = np.ma.masked_invalid(self.nmi)
        return scored.mean(axis=0), scored.std(axis=0)

    def as_json(self) -> dict[str, list[float]]:
        """The curve, to four digits; NaN where a value is masked."""
        mean, std = self.spread()
        columns = {"t": self.t, "mean": mean, "std": std}
        return {name: np.ma.filled(column, np.nan).round(4).tolist() for name, column in columns.items()}


@dataclass(frozen=True)
class ViewRequest:
    """Requested views: times in s, length of the trails in s, and whether to include affinities."""

    times: Sequence[float] = ()
    trail: float = 1.0
    affinity: bool = False


def run_seed(messages: Sequence[Message], config: FusionConfig, period: float, close: ViewRequest) -> SeedRun:
    """Run the messages of one seed, with an update every `period` seconds.

    Raises
    ------
    ValueError
        If there is no observation.
    """
    batches = [m for m in messages if isinstance(m, ObservationBatch)]
    spaces = {b.source: SpaceRef(b.space, b.unit, b.dim) for b in batches}
    start_ns, fusion, truth = batches[0].stamp_ns if batches else 0, Fusion(config), Truth()
    moments: list[Moment] = []
    views: list[View] = []

    def on_update(update: HypothesisUpdate, _: Score) -> None:
        (space,) = set(spaces.values())
        moments.append(moment_of(update, truth, spaces, space))
        t = (update.stamp_ns - start_ns) / 1e9
        due = close.times[len(views) : len(views) + 1]
        if due and t >= due[0] - period / 4:
            first_ns, now = update.stamp_ns - round(close.trail * 1e9), moments[-1]
            seen = [b for b in batches if first_ns <= b.stamp_ns <= update.stamp_ns]
            tracks = ([(b.source, b.session, identity) for identity in b.ids.tolist()] for b in seen)
            trails = trails_of(now, zip(tracks, (b.positions for b in seen), strict=True))
            views.append(View(t, now, trails, *_affinity(fusion, truth, space.name, close)))

    run = run_offline(messages, fusion, truth=truth, period=period, on_update=on_update)
    return SeedRun(run, moments, views)


def _affinity(
    fusion: Fusion, truth: Truth, space: str, close: ViewRequest
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    if not close.affinity:
        return np.zeros((0, 0), np.float32), np.zeros(0, np.int64)
    affinity = fusion.affinity(space)
    objects = np.array(
        [truth.objects((s, n), np.array([i], np.uint64))[0] for s, n, i in affinity.tracks], np.int64
    )
    order = np.argsort(objects, kind="stable")
    return affinity.matrix[np.ix_(order, order)], objects[order]
