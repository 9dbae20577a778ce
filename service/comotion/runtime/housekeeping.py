"""Does what follows a published update: reports to the Status, writes the state, frees memory."""

import ctypes
import gc
import time
from dataclasses import replace

from comotion_schemas import HypothesisUpdate

from ..fusion import Fusion
from .health import Health, Watchdog
from .intake import Intake
from .overload import Overload
from .source_clocks import SourceClocks
from .state_keeper import StateKeeper

# Twice per Status, which is published every second.
_REPORT_NS = 500_000_000
_COLLECT_NS = 1_000_000_000
# Between two times at which memory is given back: some 3 ms where an attack has taken much, else half of one.
_FREE_NS = 2_000_000_000


class Housekeeping:
    """Does what may take a moment right after an update, when the next one is farthest away."""

    def __init__(
        self,
        fusion: Fusion,
        watchdog: Watchdog,
        keeper: StateKeeper,
        clocks: SourceClocks,
        overload: Overload,
        intake: Intake,
    ) -> None:
        self._fusion, self._intake, self._keeper = fusion, intake, keeper
        self._watchdog, self._clocks, self._overload = watchdog, clocks, overload
        self._health = Health()
        self._due_ns = {"report": 0, "collect": 0, "free": 0}

    def after(self, update: HypothesisUpdate, now_ns: int) -> None:
        """Do what is due after an update was published, at a time on the clock of the core, ns."""
        monotonic_ns = time.monotonic_ns()
        self._watchdog.alive(monotonic_ns)
        if self._is_due("report", monotonic_ns, _REPORT_NS):
            self._report(monotonic_ns, now_ns)
        if self._is_due("collect", monotonic_ns, _COLLECT_NS):
            gc.collect()
        if self._is_due("free", monotonic_ns, _FREE_NS):
            self._intake.drop_idle(monotonic_ns)
            _return_memory()
        self._keeper.after(frozenset(h.id for h in update.hypotheses), time.monotonic_ns())

    def _is_due(self, what: str, monotonic_ns: int, every_ns: int) -> bool:
        if monotonic_ns < self._due_ns[what]:
            return False
        self._due_ns[what] = monotonic_ns + every_ns
        return True

    def _report(self, monotonic_ns: int, now_ns: int) -> None:
        fields = self._health.report(
            monotonic_ns,
            intake=self._intake,
            sources=self._fusion.timeline.sources.health(now_ns, monotonic_ns),
            stats=self._fusion.stats,
            notes=[
                *([self._keeper.error] if self._keeper.error else []),
                *self._overload.notes(),
                *self._clocks.notes(),
            ],
            noticed=self._fusion.timeline.troubles.lately(),
        )
        own = {"clock_steps": self._clocks.steps, "refused_statuses": self._intake.statuses.refused}
        counters = {**fields.counters, **own}
        self._watchdog.report(replace(fields, counters=counters, clock_offsets=self._clocks.offsets()))


def _return_memory() -> None:
    """Give freed memory back to the system: large batches leave holes that the C library would keep."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
    if trim is not None:
        trim(0)
