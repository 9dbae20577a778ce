"""Does what follows a published update: reports to the Status, writes the state, frees memory."""

import ctypes
import gc
import time
from dataclasses import replace

from comotion_schemas import HypothesisUpdate

from ..fusion import Fusion
from . import problems
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
    ) -> None:
        self._clocks = clocks
        self._overload = overload
        self._fusion = fusion
        self._watchdog = watchdog
        self._keeper = keeper
        self._health = Health()
        self._due_ns = {"report": 0, "collect": 0, "free": 0}

    def after(self, update: HypothesisUpdate, intake: Intake, now_ns: int) -> None:
        """Do what is due.

        Parameters
        ----------
        update
            The update that has just been published.
        intake
            Where the observations come from.
        now_ns
            The clock of the core, nanoseconds since the Unix epoch.
        """
        monotonic_ns = time.monotonic_ns()
        self._watchdog.alive(monotonic_ns)
        if self._is_due("report", monotonic_ns, _REPORT_NS):
            self._report(intake, monotonic_ns, now_ns)
        if self._is_due("collect", monotonic_ns, _COLLECT_NS):
            gc.collect()
        if self._is_due("free", monotonic_ns, _FREE_NS):
            intake.drop_idle(monotonic_ns)
            _return_memory()
        self._keeper.after(frozenset(h.id for h in update.hypotheses), time.monotonic_ns())

    def _is_due(self, what: str, monotonic_ns: int, every_ns: int) -> bool:
        if monotonic_ns < self._due_ns[what]:
            return False
        self._due_ns[what] = monotonic_ns + every_ns
        return True

    def _report(self, intake: Intake, monotonic_ns: int, now_ns: int) -> None:
        fields = self._health.report(
            monotonic_ns,
            intake=intake,
            sources=self._fusion.timeline.sources.health(now_ns, monotonic_ns),
            stats=self._fusion.stats,
            notes=self._notes(),
            found=problems.of_fusion(self._fusion),
        )
        own = {"clock_steps": self._clocks.steps, "refused_statuses": intake.statuses.refused}
        counters = {**fields.counters, **own}
        self._watchdog.report(replace(fields, counters=counters, clock_offsets=self._clocks.offsets()))

    def _notes(self) -> list[str]:
        kept = [self._keeper.error] if self._keeper.error else []
        return [*kept, *self._overload.notes(), *self._clocks.notes()]


def _return_memory() -> None:
    """Give freed memory back to the system: large batches leave holes that the C library would keep."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc alone has it
    if trim is not None:
        trim(0)
