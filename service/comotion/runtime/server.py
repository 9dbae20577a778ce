"""Runs the fusion service: the loop between Zenoh and the core.

Every turn of the loop takes in what has arrived, and either fuses ahead of time or, when a deadline is
near, computes the next update and publishes it at the deadline. Everything runs on the loop's thread but
Zenoh's reception, the Status and the writing of the state file.
"""

import gc
import logging
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from comotion_schemas import DEFAULT_SCENE, HypothesisUpdate, Keys, metrics
from comotion_schemas.component import Component, StatusFields, new_session_id
from comotion_schemas.tls import TlsFiles
from comotion_schemas.transport import SessionSettings

from ..config import FusionConfig, to_ns
from ..fusion import Fusion
from ..warm_up import prepare
from .clocks import ClockName, EventClock, HeadStart, Ticker, WallClock
from .health import Watchdog
from .housekeeping import Housekeeping
from .intake import Intake
from .log_limit import DefectLog
from .output import Output
from .overload import Overload
from .presence import Presence
from .queries import handlers
from .source_clocks import SourceClocks
from .standby import DEFAULT_LEASE_S, Election, Etcd
from .standby.follower import Follower
from .state_file import begin_afresh, load_fusion
from .state_keeper import StateKeeper

DEFAULT_NAME = "fusion"
# The loop looks for new data at least this often: often enough that little is left at the deadline.
_SLICE_NS = 20_000_000
# From the second start on, the warm-up takes less; a longer one is worth a line in the log.
_LONG_WARM_UP_S = 3.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Options of ``comotion serve``.

    `state` is the file that carries identities across restarts, written every `state_interval` s and
    whenever the set of hypotheses has changed; None: nothing is kept. Without `resume` it is overwritten by
    a new scene. With `etcd`, the urls of a cluster,
    the service is one of several replicas of the scene, of which one speaks; `lease` is the time in s after
    which one that the cluster cannot reach loses the scene. `correct_clocks` shifts the stamps of sources
    whose clocks differ from this machine's.
    """

    config: FusionConfig = field(default_factory=FusionConfig)
    scene: str = DEFAULT_SCENE
    name: str = DEFAULT_NAME
    settings: SessionSettings = field(default_factory=SessionSettings)
    clock: ClockName = "wall"
    state: Path | None = None
    state_interval: float = 1.0
    resume: bool = True
    ready_file: Path | None = None
    etcd: tuple[str, ...] = ()
    etcd_tls: TlsFiles | None = None
    lease: int = DEFAULT_LEASE_S
    correct_clocks: bool = False


def serve(options: ServeOptions) -> None:
    """Run the fusion service of a scene until SIGINT or SIGTERM.

    Raises
    ------
    ValueError
        If a name is invalid, the endpoint is, or another service has the scene.
    """
    session_id = new_session_id()
    watchdog, election = Watchdog(), _election(options, session_id)
    with (
        Component(
            role="service",
            name=options.name,
            scene=options.scene,
            settings=options.settings,
            status=lambda: _with_replica(watchdog.status(), election),
            ready_file=options.ready_file,
            session_id=session_id,
            has_token=election is not None,
        ) as component,
        ExitStack() as stack,
    ):
        presence = None if election is not None else stack.enter_context(Presence(component))
        for space, camera in options.config.linking.cameras.items():
            _log.info("linking %s to bodies in %s", space, camera.frame)
        if not _warm_up(component, options.config):
            return
        # After the warm-up: the state is tried out before it is trusted.
        fusion = _make_fusion(options, session_id)
        if presence is not None:
            presence.require()
        keeper = stack.enter_context(StateKeeper(options.state, to_ns(options.state_interval), fusion))
        leadership = election or presence
        assert leadership is not None  # noqa: S101 - there is one of the two
        loop = _Loop(options, fusion, component, leadership, watchdog, keeper)
        # Last: who is not ready yet must not be elected, and who stops gives the scene back first.
        if election is not None:
            stack.enter_context(election)
        loop.run()


def _make_fusion(options: ServeOptions, session_id: str) -> Fusion:
    scene = Keys(options.scene).scene
    if options.state is not None and options.resume:
        now_ns = time.time_ns() if options.clock == "wall" else None
        return load_fusion(options.state, options.config, scene, session_id, now_ns)
    if options.state is not None:
        begin_afresh(options.state)
    return Fusion(options.config, scene=scene, session=session_id)


def _election(options: ServeOptions, session_id: str) -> Election | None:
    """The election in which the service takes part, if any."""
    if not options.etcd:
        return None
    connect = partial(Etcd, options.etcd, options.etcd_tls)
    connect()  # a wrong url is an error now, not in a thread later
    return Election(connect, options.scene, options.name, session_id, lease=options.lease)


def _with_replica(fields: StatusFields, election: Election | None) -> StatusFields:
    if election is None:
        return fields
    epoch = election.epoch
    return replace(fields, replica="standby" if epoch is None else "active", epoch=epoch or 0)


def _warm_up(component: Component, config: FusionConfig) -> bool:
    """Compile and import what the method needs; False if the process was stopped meanwhile."""
    notice = threading.Timer(
        _LONG_WARM_UP_S,
        _log.info,
        ("preparing the methods: the first start compiles them for half a minute or more",),
    )
    notice.daemon = True
    notice.start()
    try:
        return not any(component.stop.is_set() for _ in prepare(config))
    finally:
        notice.cancel()


class _Loop:
    """Connects the core to an open component and runs it."""

    def __init__(
        self,
        options: ServeOptions,
        fusion: Fusion,
        component: Component,
        leadership: Presence | Election,
        watchdog: Watchdog,
        keeper: StateKeeper,
    ) -> None:
        self._fusion, self._component, self._leadership = fusion, component, leadership
        period_ns, limits = to_ns(options.config.period), options.config.limits
        self._overload = Overload(period_ns)
        # On a busy machine spaces wait rather than the update; what is stored for too long would be lost.
        fusion.measure(time.thread_time_ns, self._overload.cost_ns)
        self._source_clocks = SourceClocks(component, correct=options.correct_clocks)
        self._intake = Intake(component.session, component.keys, fusion.timeline.ledger, limits.sources)
        self._housekeeping = Housekeeping(
            fusion, watchdog, keeper, self._source_clocks, self._overload, self._intake
        )
        self._clock = WallClock()
        if options.clock == "event":
            self._clock = EventClock(fusion.timeline.watermark_ns)
            fusion.timeline.follow_recordings()
        self._defects = DefectLog()
        self._head_start = HeadStart(period_ns)
        labels = {"scene": options.scene, "component": options.name, "role": "service"}
        self._tick_time = metrics.histogram("tick_seconds", **labels)
        self._lag = metrics.histogram("watermark_lag_seconds", **labels)
        # The loop looks for data in slices of a period.
        self._reading_ns = round(limits.processing * min(period_ns, 2 * _SLICE_NS))
        self._answering_ns = round(limits.queries * min(period_ns, 2 * _SLICE_NS))
        # How long the last update took, and its processor time.
        self._took_ns = self._spent_ns = 0
        self._follower = None
        if isinstance(leadership, Election):
            self._follower = Follower(component, leadership, fusion, self._intake)
        self._last = fusion.update(self._clock.now_ns(), time.monotonic_ns())
        answers = handlers(fusion, lambda: self._last, component.status)
        self._output = Output(component, leadership, answers)

    def run(self) -> None:
        """Publish at every deadline until the process is stopped."""
        with _uninterrupted(), closing(self._intake):
            self._last = self._publish(self._last)
            self._component.ready()
            ticker = Ticker(to_ns(self._fusion.config.period), time.monotonic_ns())
            while not self._component.stop.is_set():
                self._receive()
                spare_ns = ticker.remaining_ns(time.monotonic_ns()) - self._head_start.ns
                if spare_ns > 0:
                    self._fuse_ahead(spare_ns)
                    continue
                self._update(ticker)
                self._judge(ticker.advance(time.monotonic_ns()))

    def _update(self, ticker: Ticker) -> None:
        """Compute an update, publish it at its deadline, and tidy up."""
        with self._fusion.faults.guard("an update"):
            update = self._compute()
            self._wait(ticker.remaining_ns(time.monotonic_ns()))
            self._last = self._publish(update)
        with self._fusion.faults.guard("housekeeping"):
            for fault in self._fusion.faults.take():
                self._defects.write(fault)
            self._housekeeping.after(self._last, self._now()[0])

    def _judge(self, skipped: int) -> None:
        """Count deadlines that were skipped, and leave out work where updates take too long."""
        self._fusion.stats.overruns += skipped
        if self._fusion.config.limits.shedding:
            self._fusion.shed(self._overload.note(self._took_ns, self._spent_ns, time.monotonic_ns()))

    def _receive(self) -> None:
        now, fusion = time.monotonic_ns(), self._fusion
        ledger = fusion.timeline.ledger
        with fusion.faults.guard("taking in batches"):
            for received in self._intake.receive(now, self._reading_ns):
                batch = self._source_clocks.correct(received)
                self._clock.observe(batch.stamp_ns - fusion.timeline.steps.shift_ns, now)
                fusion.ingest(batch)
            for status, arrived_s in self._intake.statuses.read():
                self._source_clocks.on_status(status, arrived_s)
                if status.role == "source" and "sent" in status.counters:
                    ledger.claim((status.component, status.session), status.counters["sent"], now)
            ledger.miss(now)
        if isinstance(self._leadership, Presence):
            self._leadership.look(now)  # raises where another service has the scene
        if self._follower is not None:
            with fusion.faults.guard("following another service"):
                self._follower.look()
        with fusion.faults.guard("answering queries"):
            self._output.answer(self._answering_ns)

    def _now(self) -> tuple[int, int]:
        """What stamps are compared with, and the clock of arrivals."""
        timeline = self._fusion.timeline
        # The event clock reaches what the core has accepted.
        if timeline.newest_ns is not None:
            self._clock.reach(timeline.newest_ns)
        timeline.steps.clock_set_ns = self._clock.set_by_ns()
        return self._clock.now_ns(), time.monotonic_ns()

    def _fuse_ahead(self, spare_ns: int) -> None:
        """Fuse what has come in, so that little is left to do when the update is due; then wait."""
        if spare_ns > _SLICE_NS:
            with self._fusion.faults.guard("fusing"):
                self._fusion.advance(*self._now())
        self._wait(min(spare_ns, _SLICE_NS))

    def _compute(self) -> HypothesisUpdate:
        began, spent_ns = time.monotonic_ns(), time.thread_time_ns()
        update = self._fusion.update(*self._now())
        took = time.monotonic_ns() - began
        self._head_start.note(took)
        self._took_ns, self._spent_ns = took, time.thread_time_ns() - spent_ns
        self._tick_time.observe(took / 1e9)
        return update

    def _publish(self, update: HypothesisUpdate) -> HypothesisUpdate:
        """Publish an update with the time of its publication; returns what was published."""
        update = self._output.publish(update)
        if update.stamp_ns > 0:  # not so with the event clock before the first observation
            self._lag.observe((update.published_ns - update.stamp_ns) / 1e9)
        return update

    def _wait(self, duration_ns: int) -> None:
        self._component.stop.wait(max(0, duration_ns) / 1e9)


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Keep pools of threads and the garbage collector out of the loop."""
    # Waking a pool of threads costs more than an update's small matrices take on one.
    with threadpool_limits(limits=1):
        # What exists by now stays: the collector need not look at it. Housekeeping collects the rest.
        gc.collect()
        gc.freeze()
        gc.disable()
        try:
            yield
        finally:
            gc.enable()
