"""Runs recorded or simulated messages through the core as fast as possible, and scores every update."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion.config import ThesisConfig
from comotion.library.compiling import compile_ahead
from comotion_clients.metrics import Score, Truth
from comotion_clients.scoring import Scoring
from comotion_schemas import HypothesisUpdate, ObservationBatch, TruthBatch
from comotion_schemas.errors import KnownError

from .inputs import Arrived, Incoming

_LONGEST_GAP_NS = 600_000_000_000
"""Longest time without data that is simulated, since no update changes in it."""
OnUpdate: TypeAlias = Callable[[HypothesisUpdate, Score], None]


class Run(Scoring):
    """One recording, or one seed of a scene, through the core, with its scores.

    Attributes
    ----------
    start_ns
        Event time of the first observation.
    period
        Seconds between updates.
    count
        Number of the next update.
    """

    def __init__(self, truth: Truth, start_ns: int, period: float) -> None:
        super().__init__(truth)
        self.start_ns, self.period = start_ns, period
        # Of each update: s that the ingest of its batches took, it and the update, and of processors.
        self._times: list[NDArray[np.float64]] = []
        self._busy = np.zeros(3)
        self.count = 1

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Event time of every score, seconds since the first observation."""
        return np.array([(s.stamp_ns - self.start_ns) / 1e9 for s in self.scores])

    @property
    def nmi(self) -> NDArray[np.float64]:
        """NMI of every score; NaN if no track could be scored."""
        return np.array([s.nmi for s in self.scores])

    @property
    def update_ms(self) -> NDArray[np.float64]:
        """Time in the core per update, ingest of its batches included, float64 [updates]."""
        return np.asarray(self.costs_ms[1], np.float64)

    @property
    def costs_ms(self) -> NDArray[np.float64]:
        """Time for ingest, for ingest and update, and of all processors, float64 [3, updates]."""
        return np.asarray(1e3 * np.array(self._times).T, np.float64)

    @property
    def due_ns(self) -> int:
        """When the next update is due: every period after the start."""
        return self.start_ns + round(self.count * self.period * 1e9)

    def ingest(self, fusion: Fusion, batch: ObservationBatch, *, spread: bool) -> None:
        """Let the core take in a batch, and fuse what has come if `spread`."""
        begun, cpu = time.perf_counter(), time.process_time()
        fusion.ingest(batch)
        if spread:
            fusion.advance(batch.stamp_ns)
        took = time.perf_counter() - begun
        self._busy += [took, took, time.process_time() - cpu]
        self.observed.add(batch)

    def update(self, fusion: Fusion) -> tuple[HypothesisUpdate, Score]:
        """Make the update that is due, and score it."""
        begun, cpu = time.perf_counter(), time.process_time()
        update = fusion.update(self.due_ns)
        took, cpu = time.perf_counter() - begun, time.process_time() - cpu
        self._times.append(self._busy + np.array([0.0, took, cpu]))
        self._busy = np.zeros(3)
        self.count += 1
        return update, self.score(update)


def thesis(sigma_switch: float, v_move: float | None = None) -> FusionConfig:
    """Parameters of the thesis method; equal weights unless `v_move` says otherwise."""
    return FusionConfig(method="thesis", thesis=ThesisConfig(sigma_switch=sigma_switch, v_move=v_move))


def run_offline(
    messages: Iterable[Incoming],
    config: FusionConfig | Fusion,
    *,
    truth: Truth | None = None,
    period: float | None = None,
    duration: float | None = None,
    spread: bool = False,
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
        Parameters of the core; or the core, for callers that look into it at every update.
    truth
        True objects known beforehand; what `messages` say is added.
    period
        Seconds between updates; that of `config` by default.
    duration
        Seconds of event time to run; all by default.
    spread
        Fuse what has come after every batch, as a service does; by default at every update.
    on_update
        Called with every update and its score.

    Raises
    ------
    ValueError
        If there is no observation, or the period is not above 0.
    """
    core = config if isinstance(config, Fusion) else Fusion(config)
    period = core.config.period if period is None else period
    if not period > 0:
        raise KnownError(f"the period {period:g} s is not above 0")
    truth = Truth() if truth is None else truth
    batches = _batches(messages, truth)
    first = next(batches, None)
    if first is None:
        raise KnownError("there is no observation")
    compile_ahead(core.config.method, first.batch.unit, first.batch.dim)
    stamps = first.batch.stamps_ns
    start_ns = first.batch.stamp_ns if stamps is None or not len(stamps) else int(stamps.min())
    end_ns = math.inf if duration is None else start_ns + round(duration * 1e9)
    run = Run(truth, start_ns, period)
    for arrived in chain([first], batches):
        passed = arrived.now_ns - _LONGEST_GAP_NS - start_ns
        run.count = max(run.count, math.ceil(passed / (period * 1e9)))
        while run.due_ns < arrived.now_ns and run.due_ns <= end_ns:
            on_update(*run.update(core))
        if arrived.now_ns > end_ns:
            break
        run.ingest(core, arrived.batch, spread=spread)
    if run.due_ns <= end_ns:
        on_update(*run.update(core))
    core.timeline.faults.warn(stacklevel=2)
    if not run.scores:
        raise KnownError(f"{duration:g} s are too short for an update every {period:g} s")
    return run


def _batches(messages: Iterable[Incoming], truth: Truth) -> Iterator[Arrived]:
    """Yield the observations, and add truth batches to `truth`."""
    for message in messages:
        if isinstance(message, TruthBatch):
            truth.add(message)
        elif isinstance(message, Arrived):
            yield message
        else:
            yield Arrived(message, message.stamp_ns)
