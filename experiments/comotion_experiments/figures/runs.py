"""Runs for figures: messages -> scores over time, and detailed views of some moments."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion_clients.metrics import Score, Truth
from comotion_clients.scoring import SpaceRef
from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch

from ..inputs import Message
from ..offline import run_offline
from ..trace import Moment, moment_of

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """The details of one update.

    Attributes
    ----------
    t
        Seconds since the first observation.
    moment
        Tracks, their positions, hypotheses and objects.
    trails
        Positions of each track in the last seconds, float32 [steps, dim].
    affinity
        float32 [N, N], rows sorted by object; empty unless requested.
    affinity_objects
        Object of each row, int64 [N].
    """

    t: float
    moment: Moment
    trails: list[NDArray[np.float32]]
    affinity: NDArray[np.float32]
    affinity_objects: NDArray[np.int64]


@dataclass(frozen=True)
class SeedRun:
    """One seed of one scene through the core.

    Attributes
    ----------
    t
        float64 [U], seconds since the first observation; increasing.
    nmi
        float64 [U] over the observed tracks; NaN where there is none with a truth.
    hypotheses
        int64 [U], distinct hypotheses among the scored tracks.
    views
        The requested views, in order.
    votes
        (hypothesis, object) -> tracks times updates that they share.
    main
        Hypothesis that holds most of each object's tracks at every update, int64 [U]; -1 where none does.
    names
        Names of the objects.
    """

    t: Floats
    nmi: Floats
    hypotheses: NDArray[np.int64]
    views: list[View]
    votes: dict[tuple[int, int], int]
    main: dict[int, NDArray[np.int64]]
    names: dict[int, str]

    def main_of(self, name: str) -> NDArray[np.int64]:
        """`main` of an object by its name; -1 throughout where nothing of it was ever seen."""
        numbers = (number for number, known in self.names.items() if known == name)
        return self.main.get(next(numbers, -1), np.full(len(self.t), -1))


@dataclass(frozen=True)
class SceneRuns:
    """The seeds of one scene, run with one set of parameters."""

    seeds: list[SeedRun]

    @property
    def t(self) -> Floats:
        """Times that all seeds have, float64 [U]."""
        return min((seed.t for seed in self.seeds), key=len)

    @property
    def nmi(self) -> Floats:
        """float64 [seeds, U]."""
        return np.array([seed.nmi[: len(self.t)] for seed in self.seeds])

    @property
    def hypotheses(self) -> NDArray[np.int64]:
        """int64 [seeds, U]."""
        return np.array([seed.hypotheses[: len(self.t)] for seed in self.seeds])

    def mean_nmi(self) -> Floats:
        """Mean over time of every seed, float64 [seeds]."""
        return np.array([np.nanmean(seed.nmi) for seed in self.seeds])

    def nmi_at(self, t: float) -> float:
        """Mean over seeds at the update nearest to a time."""
        return float(np.nanmean(self.nmi[:, np.abs(self.t - t).argmin()]))


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
    watch = _Watch(messages, Fusion(config), period, close)
    run = run_offline(
        messages, config, truth=watch.truth, period=period, fusion=watch.fusion, on_update=watch.see
    )
    return SeedRun(
        t=run.seconds,
        nmi=run.nmi,
        hypotheses=np.array([score.hypotheses for score in run.scores]),
        views=watch.views,
        votes=watch.votes,
        main=watch.main(),
        names=dict(run.truth.names),
    )


@dataclass
class _Watch:
    """Collects views and votes at every update."""

    messages: Sequence[Message]
    fusion: Fusion
    period: float
    close: ViewRequest
    truth: Truth = field(default_factory=Truth)
    views: list[View] = field(default_factory=list)
    votes: Counter[tuple[int, int]] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        batches = [m for m in self.messages if isinstance(m, ObservationBatch)]
        self._start_ns = batches[0].stamp_ns if batches else 0
        self._spaces = {b.source: SpaceRef(b.space, b.unit, b.dim) for b in batches}
        self._trails = Trails(batches)
        self._main: list[dict[int, int]] = []

    def see(self, update: HypothesisUpdate, _: Score) -> None:
        (space,) = set(self._spaces.values())
        moment = moment_of(update, self.truth, self._spaces, space)
        now = Counter(zip(moment.hypotheses.tolist(), moment.objects.tolist(), strict=True))
        self.votes.update(now)
        # The last one stays: the most frequent, and of two as frequent the smaller id.
        ranked = sorted(now.items(), key=lambda item: (item[1], -item[0][0]))
        self._main.append({number: hypothesis for (hypothesis, number), _ in ranked})
        t = (update.stamp_ns - self._start_ns) / 1e9
        due = self.close.times[len(self.views) : len(self.views) + 1]
        if due and t >= due[0] - self.period / 4:
            trails = self._trails.until(moment, round(self.close.trail * 1e9))
            self.views.append(View(t, moment, trails, *self._affinity(space.name)))

    def main(self) -> dict[int, NDArray[np.int64]]:
        """Hypothesis that holds most of each object's tracks, by update."""
        numbers = sorted({number for row in self._main for number in row if number >= 0})
        rows = {n: [row.get(n, UNDETERMINED) for row in self._main] for n in numbers}
        return {n: np.array([-1 if h == UNDETERMINED else h for h in row]) for n, row in rows.items()}

    def _affinity(self, space: str) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        if not self.close.affinity:
            return np.zeros((0, 0), np.float32), np.zeros(0, np.int64)
        affinity = self.fusion.affinity(space)
        objects = np.array(
            [self.truth.objects((s, n), np.array([i], np.uint64))[0] for s, n, i in affinity.tracks], np.int64
        )
        order = np.argsort(objects, kind="stable")
        return affinity.matrix[np.ix_(order, order)], objects[order]


class Trails:
    """Past positions of tracks, from the observations."""

    def __init__(self, batches: Sequence[ObservationBatch]) -> None:
        self._batches = batches

    def until(self, moment: Moment, length_ns: int) -> list[NDArray[np.float32]]:
        """Positions [steps, dim] of each track of a moment within `length_ns` before it."""
        ways: dict[tuple[str, str, int], list[NDArray[np.float32]]] = {key: [] for key in moment.tracks}
        for batch in self._within(moment.stamp_ns - length_ns, moment.stamp_ns):
            for identity, position in zip(batch.ids.tolist(), batch.positions, strict=True):
                way = ways.get((batch.source, batch.session, identity))
                if way is not None:
                    way.append(position)
        dim = moment.positions.shape[1]
        return [np.array(way, np.float32).reshape(-1, dim) for way in ways.values()]

    def _within(self, first_ns: int, last_ns: int) -> Iterator[ObservationBatch]:
        return (batch for batch in self._batches if first_ns <= batch.stamp_ns <= last_ns)
