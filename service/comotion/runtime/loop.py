"""Runs the loop between Zenoh and the core.

Every turn of the loop takes in what has arrived, and either fuses ahead of time or, when a deadline is
near, computes the next update and publishes it at the deadline. What may take a moment is done right after
that, when the next update is farthest away: reporting, writing the state, freeing memory. Everything runs on
the loop's thread but Zenoh's reception, the Status and the writing of the state file.
"""

import ctypes
import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

from comotion_schemas import HypothesisUpdate, metrics
from comotion_schemas.component import Component

from ..config import to_ns
from ..fusion import Fusion
from .clocks import EventClock, Overload, SourceClocks, Ticker, WallClock
from .health import Health
from .intake import Intake
from .log_limit import log_defect
from .output import Output, handlers
from .presence import Presence
from .standby.election import Election, Follower
from .state_file import StateKeeper

# The loop looks for new data at least this often: often enough that little is left at the deadline.
_SLICE_NS = 20_000_000
# Shares of a turn for reading batches and for answering queries; of each one is taken in any case.
_READING, _ANSWERING = 0.5, 0.1
# Between two reports, two for each Status. Memory is given back with them, which takes some 3 ms where an
# attack has taken much, else half of one.
_REPORT_NS = 500_000_000


class Loop:
    """Connects the core to an open component and runs it; `recorded`: sources play recordings."""

    def __init__(
        self,
        fusion: Fusion,
        component: Component,
        leadership: Presence | Election,
        health: Health,
        keeper: StateKeeper | None,
        clocks: SourceClocks,
        *,
        recorded: bool,
    ) -> None:
        self._fusion, self._component, self._leadership = fusion, component, leadership
        self._health, self._keeper, self._source_clocks = health, keeper, clocks
        period_ns = to_ns(fusion.config.period)
        self._overload = Overload(period_ns)
        # On a busy machine spaces wait rather than the update; batches that wait for too long would be lost.
        fusion.measure(time.thread_time_ns, self._overload.cost_ns)
        self._intake = Intake(component.session, component.keys, fusion.timeline)
        self._clock = EventClock(fusion.timeline.watermark_ns) if recorded else WallClock()
        if recorded:
            fusion.timeline.replay()
        self._report_ns = 0
        labels = {"scene": component.keys.scene, "component": component.name, "role": "service"}
        self._tick_time = metrics.histogram("tick_seconds", **labels)
        self._lag = metrics.histogram("watermark_lag_seconds", **labels)
        # The loop looks for data in slices of a period.
        self._reading_ns = round(_READING * min(period_ns, 2 * _SLICE_NS))
        self._answering_ns = round(_ANSWERING * min(period_ns, 2 * _SLICE_NS))
        self._follower = None
        if isinstance(leadership, Election):
            self._follower = Follower(component, leadership, fusion, self._intake)
        self._last = fusion.update(self._clock.now_ns(), time.monotonic_ns())
        answers = handlers(fusion, lambda: self._last, component.status)
        self._output = Output(component, leadership, answers, fusion.timeline.faults)

    def run(self) -> None:
        """Publish at every deadline until the process is stopped."""
        with _uninterrupted():
            self._last = self._publish(self._last)
            self._component.ready()
            ticker = Ticker(to_ns(self._fusion.config.period), time.monotonic_ns())
            while not self._component.stop.is_set():
                self._receive()
                spare_ns = ticker.remaining_ns(time.monotonic_ns()) - ticker.head_start_ns
                if spare_ns > 0:
                    # So that little is left to do when the update is due.
                    with self._fusion.timeline.faults.guard("fusing"):
                        if spare_ns > _SLICE_NS:
                            self._fusion.advance(*self._now())
                    self._component.stop.wait(min(spare_ns, _SLICE_NS) / 1e9)
                    continue
                self._update(ticker)

    def _update(self, ticker: Ticker) -> None:
        """Compute an update, publish it at its deadline, and tidy up."""
        took_ns = cost_ns = 0
        with self._fusion.timeline.faults.guard("an update"):
            began_ns, spent_ns = time.monotonic_ns(), time.thread_time_ns()
            update = self._fusion.update(*self._now(), level=self._overload.level)
            took_ns, cost_ns = time.monotonic_ns() - began_ns, time.thread_time_ns() - spent_ns
            ticker.note(took_ns)
            self._tick_time(took_ns / 1e9)
            self._component.stop.wait(max(0, ticker.remaining_ns(time.monotonic_ns())) / 1e9)
            self._last = self._publish(update)
        with self._fusion.timeline.faults.guard("housekeeping"):
            self._tidy()
        self._judge(ticker.advance(time.monotonic_ns()), took_ns, cost_ns)

    def _judge(self, skipped: int, took_ns: int, cost_ns: int) -> None:
        """Count deadlines that were skipped, and leave out work where updates take too long."""
        self._fusion.stats.overruns += skipped
        if self._fusion.config.limits.shedding:
            self._overload.note(took_ns, cost_ns, time.monotonic_ns())

    def _receive(self) -> None:
        now, fusion = time.monotonic_ns(), self._fusion
        ledger, faults = fusion.timeline.ledger, fusion.timeline.faults
        with faults.guard("taking in batches"):
            for received in self._intake.receive(now, self._reading_ns):
                batch = self._source_clocks.correct(received)
                if isinstance(self._clock, EventClock):
                    self._clock.observe(batch.stamp_ns - fusion.timeline.clock.shift_ns, now)
                fusion.ingest(batch)
            for status, arrived_s in self._intake.statuses.read():
                if status.role != "source":
                    continue
                self._intake.tokens.heard.add(status.component)
                self._source_clocks.on_status(status, arrived_s)
                if "sent" in status.counters:
                    ledger.claim((status.component, status.session), status.counters["sent"], now)
            ledger.miss(now)
        if isinstance(self._leadership, Presence):
            self._leadership.look(now)  # raises where another service has the scene
        if self._follower is not None:
            with faults.guard("following another service"):
                self._follower.look()
        with faults.guard("answering queries"):
            self._output.answer(self._answering_ns)

    def _now(self) -> tuple[int, int]:
        """The time that stamps are compared with, and the clock of arrivals."""
        timeline, clock = self._fusion.timeline, self._clock
        if isinstance(clock, WallClock):
            timeline.clock.clock_set_ns = clock.set_by_ns()
        # The event clock reaches what the core has accepted.
        elif sources := timeline.sources.values():
            clock.reach(max(source.newest_ns for source in sources))
        return clock.now_ns(), time.monotonic_ns()

    def _publish(self, update: HypothesisUpdate) -> HypothesisUpdate:
        update = self._output.publish(update)
        if update.stamp_ns > 0:  # not so with the event clock before the first observation
            self._lag((update.published_ns - update.stamp_ns) / 1e9)
        return update

    def _tidy(self) -> None:
        for fault in self._fusion.timeline.faults.take():
            log_defect(fault)
        self._health.alive_ns = at_ns = time.monotonic_ns()
        if at_ns >= self._report_ns:
            self._report_ns = at_ns + _REPORT_NS
            error, clocks = "" if self._keeper is None else self._keeper.error, self._source_clocks
            notes = [*([error] if error else []), *self._overload.notes(), *clocks.notes()]
            self._health.report(at_ns, self._now()[0], self._fusion.timeline, self._intake, clocks, notes)
            gc.collect()
            # Large batches leave holes that the C library would keep; glibc alone can give them back.
            if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
                trim(0)
        if self._keeper is not None:
            self._keeper.after(frozenset(h.id for h in self._last.hypotheses), time.monotonic_ns())


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Keep pools of threads and the garbage collector out of the loop."""
    # Waking a pool of threads costs more than an update's small matrices take on one.
    with threadpool_limits(limits=1):
        # Objects that exist by now stay: the collector need not visit them. Tidying collects the rest.
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            yield
        finally:
            gc.enable()
