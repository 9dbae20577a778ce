"""Options in; a fusion service on the wire out: the loop between Zenoh and the core.

Every turn of the loop takes in what has arrived, and either fuses ahead of time or, when a deadline is
near, computes the next update and publishes it at the deadline. Everything runs on the loop's thread but
Zenoh's reception, the Status and the writing of the state file.
"""

import gc
import logging
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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
    metrics,
)
from comotion_schemas.component import Component, StatusFields, new_session_id
from comotion_schemas.transport import SessionSettings, TlsFiles

from ..config import FusionConfig, to_ns
from ..fusion import Fusion
from .clocks import ClockName, make_clock
from .election import DEFAULT_LEASE_S, Alone, Election
from .etcd import Etcd
from .health import Watchdog
from .housekeeping import Housekeeping
from .intake import Intake
from .output import Follower, Output
from .queries import handlers
from .state_file import load_fusion
from .state_keeper import StateKeeper
from .ticker import HeadStart, Ticker
from .warm_up import warm_up

DEFAULT_NAME = "fusion"
# The loop looks for new data at least this often: often enough that little is left at the deadline.
_SLICE_NS = 20_000_000
# A service that answers does so well within this time, even through a router.
_STATUS_TIMEOUT_S = 2.0
# From the second start on, the warm-up takes less; a longer one is worth a line in the log.
_LONG_WARM_UP_S = 3.0
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Options of ``comotion serve``.

    `state` is the file that carries identities across restarts, written every `state_interval` s and
    whenever the set of hypotheses has changed; None: nothing is kept. With `etcd`, the urls of a cluster,
    the service is one of several replicas of the scene, of which one speaks; `lease` is the time in s after
    which one that the cluster cannot reach loses the scene.
    """

    config: FusionConfig = field(default_factory=FusionConfig)
    scene: str = DEFAULT_SCENE
    name: str = DEFAULT_NAME
    settings: SessionSettings = field(default_factory=SessionSettings)
    clock: ClockName = "wall"
    state: Path | None = None
    state_interval: float = 1.0
    ready_file: Path | None = None
    etcd: tuple[str, ...] = ()
    etcd_tls: TlsFiles | None = None
    lease: int = DEFAULT_LEASE_S


def serve(options: ServeOptions) -> None:
    """Run the fusion service of a scene until SIGINT or SIGTERM.

    Raises
    ------
    ValueError
        If a name is invalid, the endpoint is, or another service has the scene.
    """
    session_id = new_session_id()
    watchdog, replica = Watchdog(), _replica(options, session_id)
    with Component(
        role="service",
        name=options.name,
        scene=options.scene,
        settings=options.settings,
        status=lambda: _with_replica(watchdog.status(), replica),
        ready_file=options.ready_file,
        session_id=session_id,
    ) as component:
        _require_alone(component, options)
        for space, camera in options.config.linking.cameras.items():
            _log.info("linking %s to bodies in %s", space, camera.frame)
        if not _warm_up(component, options.config):
            return
        # After the warm-up: the state is tried out before it is trusted.
        fusion = _make_fusion(options, session_id)
        with ExitStack() as stack:
            keeper = stack.enter_context(StateKeeper(options.state, to_ns(options.state_interval), fusion))
            if isinstance(replica, Election):
                stack.enter_context(replica)
            _Loop(options, fusion, component, Housekeeping(fusion, watchdog, keeper), replica).run()


def _make_fusion(options: ServeOptions, session_id: str) -> Fusion:
    scene = Keys(options.scene).scene
    if options.state is None:
        return Fusion(options.config, scene=scene, session=session_id)
    now_ns = time.time_ns() if options.clock == "wall" else None
    return load_fusion(options.state, options.config, scene, session_id, now_ns)


def _replica(options: ServeOptions, session_id: str) -> Alone | Election:
    """Whether the service speaks alone, or takes part in an election."""
    if not options.etcd:
        return Alone()
    Etcd(options.etcd, options.etcd_tls)  # a wrong url is an error now, not in a thread later
    return Election(
        lambda: Etcd(options.etcd, options.etcd_tls),
        options.scene,
        options.name,
        session_id,
        lease=options.lease,
    )


def _with_replica(fields: StatusFields, replica: Alone | Election) -> StatusFields:
    if isinstance(replica, Alone):
        return fields
    epoch = replica.epoch
    return replace(fields, replica="standby" if epoch is None else "active", epoch=epoch or 0)


def _require_alone(component: Component, options: ServeOptions) -> None:
    """Two services in one scene would publish two different answers on the same key."""
    if options.etcd:
        return
    for reply in component.session.get(component.keys.query("status"), timeout=_STATUS_TIMEOUT_S):
        if reply.ok is None:
            continue
        try:
            other = decode_as(Status, reply.ok.payload.to_bytes())
        except DecodeError:
            continue
        raise ValueError(f"scene {component.keys.scene!r} is already served by {other.component!r}")


def _warm_up(component: Component, config: FusionConfig) -> bool:
    """Compile and import what the method needs; False if the process was stopped meanwhile."""
    notice = threading.Timer(
        _LONG_WARM_UP_S,
        _log.info,
        ("preparing the methods: half a minute on the first start, to compile them",),
    )
    notice.daemon = True
    notice.start()
    try:
        return not any(component.stop.is_set() for _ in warm_up(config))
    finally:
        notice.cancel()


class _Loop:
    """Connects the core to an open component and runs it."""

    def __init__(
        self,
        options: ServeOptions,
        fusion: Fusion,
        component: Component,
        housekeeping: Housekeeping,
        replica: Alone | Election,
    ) -> None:
        self._fusion = fusion
        self._component = component
        self._housekeeping = housekeeping
        self._clock = make_clock(options.clock, fusion.watermark_ns)
        self._head_start = HeadStart(to_ns(options.config.period))
        labels = {"scene": options.scene, "component": options.name, "role": "service"}
        self._tick_time = metrics.histogram("tick_seconds", **labels)
        self._lag = metrics.histogram("watermark_lag_seconds", **labels)
        self._intake = Intake(component.session, component.keys, fusion.stats)
        self._follower = Follower(component, replica, fusion) if isinstance(replica, Election) else None
        self._last = fusion.update(self._clock.now_ns())
        self._output = Output(component, replica, handlers(fusion, lambda: self._last, component.status))
        self._last = self._publish(self._last)

    def run(self) -> None:
        """Publish at every deadline until the process is stopped."""
        with _uninterrupted():
            self._component.ready()
            ticker = Ticker(to_ns(self._fusion.config.period), time.monotonic_ns())
            while not self._component.stop.is_set():
                self._receive()
                spare_ns = ticker.remaining_ns(time.monotonic_ns()) - self._head_start.ns
                if spare_ns > 0:
                    self._fuse_ahead(spare_ns)
                    continue
                update = self._compute()
                self._wait(ticker.remaining_ns(time.monotonic_ns()))
                self._last = self._publish(update)
                self._housekeeping.after(self._last, self._intake, self._clock.now_ns())
                self._fusion.stats.overruns += ticker.advance(time.monotonic_ns())

    def _receive(self) -> None:
        now = time.monotonic_ns()
        for batch in self._intake.receive(now):
            if self._clock.observe(batch.stamp_ns, now):
                _log.info("time starts over with a batch of %s", batch.source)
                self._fusion.start_over()
            self._fusion.ingest(batch)
        if self._follower is not None:
            self._follower.look()
        self._output.answer()

    def _fuse_ahead(self, spare_ns: int) -> None:
        """Fuse what has come in, so that little is left to do when the update is due; then wait."""
        if spare_ns > _SLICE_NS:
            self._fusion.advance(self._clock.now_ns())
        self._wait(min(spare_ns, _SLICE_NS))

    def _compute(self) -> HypothesisUpdate:
        began = time.monotonic_ns()
        update = self._fusion.update(self._clock.now_ns())
        took = time.monotonic_ns() - began
        self._head_start.note(took)
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
