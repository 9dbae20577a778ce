"""Offline runs: recorded or simulated messages -> scored updates of the core, as fast as possible."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion.config import ThesisConfig
from comotion.event_time.faults import warn_of
from comotion.event_time.stats import Stats
from comotion_clients.metrics import Score, Truth
from comotion_clients.scoring import Observed, SpaceRef, Summary, Tally
from comotion_schemas import HypothesisUpdate, ObservationBatch, TruthBatch
from comotion_schemas.errors import KnownError

Message: TypeAlias = TruthBatch | ObservationBatch


@dataclass(frozen=True, slots=True)
class Arrived:
    """A batch with the time of the service clock at its receipt, for recordings."""

    batch: ObservationBatch
    now_ns: int


Incoming: TypeAlias = Message | Arrived
_LONGEST_GAP_NS = 600_000_000_000
"""Longest time without data that is simulated, since no update changes in it."""
OnUpdate: TypeAlias = Callable[[HypothesisUpdate, Score], None]


@dataclass(frozen=True)
class Run:
    """One recording, or one seed of a scene, through the core.

    Attributes
    ----------
    summary
        Summary of the scores.
    scores
        One per update, in order.
    update_ms
        float64 [updates]: time in the core per update, ingest of its batches included.
    start_ns
        Event time of the first observation.
    truth
        The true objects.
    spaces
        Coordinate space of every source.
    stats
        The core's counters at the end.
    last
        The last update.
    """

    summary: Summary
    scores: list[Score]
    update_ms: NDArray[np.float64]
    start_ns: int
    truth: Truth
    spaces: dict[str, SpaceRef]
    stats: Stats
    last: HypothesisUpdate

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Event time of every score, seconds since the first observation."""
        return np.array([(s.stamp_ns - self.start_ns) / 1e9 for s in self.scores])

    @property
    def nmi(self) -> NDArray[np.float64]:
        """NMI of every score; NaN if no track could be scored."""
        return np.array([s.nmi for s in self.scores])


def thesis(sigma_switch: float, v_move: float | None = None) -> FusionConfig:
    """Parameters of the thesis method; equal weights unless `v_move` says otherwise."""
    return FusionConfig(method="thesis", thesis=ThesisConfig(sigma_switch=sigma_switch, v_move=v_move))


@dataclass
class _Offline:
    fusion: Fusion
    tally: Tally
    on_update: OnUpdate
    observed: Observed = field(default_factory=Observed)
    times: list[float] = field(default_factory=list)
    busy: float = 0.0
    last: HypothesisUpdate = field(init=False)

    def ingest(self, batch: ObservationBatch) -> None:
        begun = time.perf_counter()
        self.fusion.ingest(batch)
        self.busy += time.perf_counter() - begun
        self.observed.add(batch)

    def update(self, now_ns: int) -> None:
        begun = time.perf_counter()
        self.last = update = self.fusion.update(now_ns)
        self.times.append((self.busy + time.perf_counter() - begun) * 1e3)
        self.busy = 0.0
        self.on_update(update, self.tally.add(update, self.observed))

    def run(self, start_ns: int, truth: Truth) -> Run:
        return Run(
            summary=self.tally.summary(),
            scores=self.tally.scores,
            update_ms=np.array(self.times),
            start_ns=start_ns,
            truth=truth,
            spaces=dict(self.observed.spaces),
            stats=self.fusion.stats,
            last=self.last,
        )


@dataclass
class _Due:
    """Instants of updates, every period after the start."""

    start_ns: int
    period: float
    count: int = 1

    @property
    def ns(self) -> int:
        return self.start_ns + round(self.count * self.period * 1e9)

    def next(self) -> int:
        now_ns = self.ns
        self.count += 1
        return now_ns

    def skip_to(self, ns: int) -> None:
        self.count = max(self.count, math.ceil((ns - self.start_ns) / (self.period * 1e9)))


def run_offline(
    messages: Iterable[Incoming],
    config: FusionConfig,
    *,
    truth: Truth | None = None,
    period: float | None = None,
    duration: float | None = None,
    fusion: Fusion | None = None,
    on_update: OnUpdate = lambda update, score: None,  # noqa: ARG005
) -> Run:
    """Run messages through the core and score every update.

    The clock is simulated: updates are due every period after the first observation, and each sees
    the batches stamped until then; of :class:`Arrived` ones those that have come until then.

    Parameters
    ----------
    messages
        Observations of one or several sources in time order; truth anywhere before it matters.
    config
        Parameters of the core.
    truth
        True objects known beforehand; what `messages` say is added.
    period
        Seconds between updates; that of `config` by default.
    duration
        Seconds of event time to run; all by default.
    fusion
        The core, for callers that look into it at every update; a new one of `config` by default.
    on_update
        Called with every update and its score.

    Raises
    ------
    ValueError
        If there is no observation, or the period is not above 0.
    """
    period = config.period if period is None else period
    if not period > 0:
        raise KnownError(f"the period {period:g} s is not above 0")
    truth = Truth() if truth is None else truth
    batches = _batches(messages, truth)
    first = next(batches, None)
    if first is None:
        raise KnownError("there is no observation")
    offline = _Offline(fusion or Fusion(config), Tally(truth), on_update)
    start_ns = _start(first.batch)
    end_ns = math.inf if duration is None else start_ns + round(duration * 1e9)
    due = _Due(start_ns, period)
    for arrived in chain([first], batches):
        due.skip_to(arrived.now_ns - _LONGEST_GAP_NS)
        while due.ns < arrived.now_ns and due.ns <= end_ns:
            offline.update(due.next())
        if arrived.now_ns > end_ns:
            break
        offline.ingest(arrived.batch)
    if due.ns <= end_ns:
        offline.update(due.ns)
    warn_of(offline.fusion.faults.take(), stacklevel=2)
    if not offline.times:
        raise KnownError(f"{duration:g} s are too short for an update every {period:g} s")
    return offline.run(start_ns, truth)


def _start(batch: ObservationBatch) -> int:
    stamps = batch.stamps_ns
    return batch.stamp_ns if stamps is None or not len(stamps) else int(stamps.min())


def _batches(messages: Iterable[Incoming], truth: Truth) -> Iterator[Arrived]:
    """Yield the observations, and add truth batches to `truth`."""
    for message in messages:
        if isinstance(message, TruthBatch):
            truth.add(message)
        elif isinstance(message, Arrived):
            yield message
        else:
            yield Arrived(message, message.stamp_ns)
