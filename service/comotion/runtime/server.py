"""The service process: a loop on the monotonic clock between the wire and the core."""

import gc
import logging
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from comotion_schemas import (
    DEFAULT_SCENE,
    DecodeError,
    HypothesisUpdate,
    Keys,
    Status,
    decode_as,
    encode,
    metrics,
)
from comotion_schemas.component import Component, StatusFields, new_session_id
from comotion_schemas.transport import SessionSettings, declare_publisher

from ..config import FusionConfig, to_ns
from ..fusion import Fusion
from .clocks import ClockName, make_clock
from .health import Health
from .intake import Intake
from .queries import Queryables, handlers
from .rehearsal import rehearse
from .state_file import StateSchedule, StateWriter, load_fusion
from .ticker import HeadStart, Ticker

DEFAULT_NAME = "fusion"
_SLICE_NS = 20_000_000
_HEALTH_NS = 500_000_000
_HANGING_NS = 3_000_000_000
_PATIENCE_S = 3.0
_COLLECT_NS = 1_000_000_000
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Everything ``comotion serve`` can be told.

    `state` is the file that carries identities across restarts, written every `state_interval` s and
    whenever the set of hypotheses has changed.
    """

    config: FusionConfig = field(default_factory=FusionConfig)
    scene: str = DEFAULT_SCENE
    name: str = DEFAULT_NAME
    settings: SessionSettings = field(default_factory=SessionSettings)
    clock: ClockName = "wall"
    state: Path | None = None
    state_interval: float = 1.0
    ready_file: Path | None = None


def serve(options: ServeOptions) -> None:
    """Run the fusion service of a scene until SIGINT or SIGTERM.

    Raises
    ------
    ValueError
        If a name is invalid, the endpoint is, or another service has the scene.
    OSError
        If the directory of the state file cannot be made.
    """
    session_id = new_session_id()
    fusion = _make_fusion(options, session_id)
    monitor = _Monitor()
    with Component(
        role="service",
        name=options.name,
        scene=options.scene,
        settings=options.settings,
        status=monitor.status,
        ready_file=options.ready_file,
        session_id=session_id,
    ) as component:
        _require_alone(component)
        for space, camera in options.config.cameras.items():
            _log.info("linking %s to bodies in %s", space, camera.frame)
        if _prepare(component, options.config):
            _Service(options, fusion, component, monitor).run()


def _make_fusion(options: ServeOptions, session_id: str) -> Fusion:
    scene = Keys(options.scene).scene
    if options.state is None:
        return Fusion(options.config, scene=scene, session=session_id)
    options.state.parent.mkdir(parents=True, exist_ok=True)
    now_ns = time.time_ns() if options.clock == "wall" else None
    return load_fusion(options.state, options.config, scene, session_id, now_ns)


def _require_alone(component: Component) -> None:
    """Two services in one scene would give two answers to everything."""
    for reply in component.session.get(component.keys.query("status"), timeout=2.0):
        if reply.ok is None:
            continue
        try:
            other = decode_as(Status, reply.ok.payload.to_bytes())
        except DecodeError:
            continue
        raise ValueError(f"scene {component.keys.scene!r} is already served by {other.component!r}")


def _prepare(component: Component, config: FusionConfig) -> bool:
    """Compile and import what the method needs; False when told to stop meanwhile."""
    patience = threading.Timer(
        _PATIENCE_S, _log.info, ("preparing the methods: half a minute on the first start, to compile them",)
    )
    patience.daemon = True
    patience.start()
    try:
        return not any(component.stop.is_set() for _ in rehearse(config))
    finally:
        patience.cancel()


class _Monitor:
    """Hands the loop's report to the Status thread, and notices when the loop hangs."""

    def __init__(self) -> None:
        self._fields = StatusFields(message="preparing")
        self._alive_ns: int | None = None

    def report(self, fields: StatusFields) -> None:
        self._fields = fields

    def alive(self, monotonic_ns: int) -> None:
        self._alive_ns = monotonic_ns

    def status(self) -> StatusFields:
        fields, alive_ns = self._fields, self._alive_ns
        silence = 0 if alive_ns is None else time.monotonic_ns() - alive_ns
        if silence <= _HANGING_NS:
            return fields
        return replace(fields, state="stalled", message=f"no update for {silence / 1e9:.1f} s")


class _Service:
    """Wires the core to an open component and runs it."""

    def __init__(
        self, options: ServeOptions, fusion: Fusion, component: Component, monitor: _Monitor
    ) -> None:
        self._options = options
        self._fusion = fusion
        self._component = component
        self._monitor = monitor
        self._clock = make_clock(options.clock)
        self._health = Health()
        self._intake = Intake(component.session, component.keys, fusion.stats)
        self._publisher = declare_publisher(component.session, component.keys.hypotheses, "hypotheses")
        self._writer: StateWriter | None = None
        self._state_schedule = StateSchedule(to_ns(options.state_interval))
        self._last = self._publish(fusion.update(self._clock.now_ns()))
        self._queryables = Queryables(
            component.session, component.keys, handlers(fusion, lambda: self._last, component.status)
        )
        self._due = {"health": 0, "collect": 0, "idle": 0}
        who = {"scene": options.scene, "component": options.name, "role": "service"}
        self._tick_time = metrics.histogram("tick_seconds", **who)
        self._lag = metrics.histogram("watermark_lag_seconds", **who)

    def run(self) -> None:
        """Publish at every deadline until told to stop."""
        with ExitStack() as stack:
            if self._options.state is not None:
                self._writer = StateWriter(self._options.state)
                stack.callback(self._writer.close)
            # Waking a pool of threads costs more than an update's small matrices take on one.
            stack.enter_context(threadpool_limits(limits=1))
            stack.callback(gc.enable)
            # Everything made so far stays: the collector need never look at it again.
            gc.collect()
            gc.freeze()
            gc.disable()
            self._component.ready()
            self._loop()
            if self._writer is not None:
                self._writer.put(self._fusion.snapshot(clean=True))

    def _loop(self) -> None:
        period_ns = to_ns(self._fusion.config.period)
        ticker, head_start = Ticker(period_ns, time.monotonic_ns()), HeadStart(period_ns)
        while not self._component.stop.is_set():
            self._receive()
            began = time.monotonic_ns()
            spare = ticker.remaining_ns(began) - head_start.ns
            if spare > 0:
                self._use(spare)
                continue
            update = self._fusion.update(self._clock.now_ns())
            took = time.monotonic_ns() - began
            head_start.note(took)
            self._tick_time.observe(took / 1e9)
            self._component.stop.wait(max(0, ticker.remaining_ns(time.monotonic_ns())) / 1e9)
            self._last = self._publish(update)
            if update.stamp_ns:  # 0 until the first observation
                self._lag.observe((self._last.published_ns - update.stamp_ns) / 1e9)
            self._housekeeping(time.monotonic_ns())
            self._fusion.stats.overruns += ticker.advance(time.monotonic_ns())

    def _use(self, spare_ns: int) -> None:
        """Fuse what has come in, so that little is left to do when the update is due; then rest."""
        if spare_ns > _SLICE_NS:
            self._fusion.advance(self._clock.now_ns())
        self._component.stop.wait(min(spare_ns, _SLICE_NS) / 1e9)

    def _receive(self) -> None:
        now = time.monotonic_ns()
        for batch in self._intake.receive(now):
            self._clock.observe(batch.stamp_ns, now)
            self._fusion.ingest(batch)
        self._queryables.answer()

    def _publish(self, update: HypothesisUpdate) -> HypothesisUpdate:
        update = replace(update, published_ns=time.time_ns())
        self._publisher.put(encode(update))
        return update

    def _housekeeping(self, now_ns: int) -> None:
        """Do what may take a moment right after an update, when the next is farthest away."""
        self._monitor.alive(now_ns)
        if self._is_due("health", now_ns, _HEALTH_NS):
            self._report(now_ns)
        if self._is_due("idle", now_ns, 10 * _COLLECT_NS):
            self._intake.drop_idle(now_ns)
        if self._is_due("collect", now_ns, _COLLECT_NS):
            gc.collect()
        self._keep_state(time.monotonic_ns())

    def _keep_state(self, now_ns: int) -> None:
        if self._writer is None:
            return
        hypotheses = frozenset(h.id for h in self._last.hypotheses)
        if self._state_schedule.is_due(now_ns, hypotheses):
            self._writer.put(self._fusion.snapshot())
            self._state_schedule.taken(now_ns, time.monotonic_ns() - now_ns, hypotheses)

    def _is_due(self, what: str, now_ns: int, every_ns: int) -> bool:
        if now_ns < self._due[what]:
            return False
        self._due[what] = now_ns + every_ns
        return True

    def _report(self, now_ns: int) -> None:
        self._monitor.report(
            self._health.report(
                now_ns,
                received=self._intake.received,
                present=self._intake.present,
                sources=self._fusion.sources(self._clock.now_ns()),
                stats=self._fusion.stats,
                rejection=self._intake.rejection,
                notes=[self._writer.error] if self._writer is not None and self._writer.error else [],
            )
        )
