"""Runs the fusion service: opens its parts, compiles, and starts its loop."""

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

from comotion_schemas import DEFAULT_SCENE, Keys
from comotion_schemas.component import Component, new_session_id
from comotion_schemas.tls import TlsFiles
from comotion_schemas.transport import SessionSettings

from ..config import FusionConfig, to_ns
from ..fusion import Fusion
from ..warm_up import prepare
from .clocks import ClockName, SourceClocks
from .health import Health
from .loop import Loop
from .presence import Presence
from .standby.election import DEFAULT_LEASE_S, Election
from .standby.etcd import Etcd
from .state_file import StateKeeper, begin_afresh, load_fusion

DEFAULT_NAME = "fusion"
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

    Raises ValueError if a name is invalid, the endpoint is, or another service has the scene.
    """
    session_id = new_session_id()
    health, election = Health(), _election(options, session_id)
    with (
        Component(
            role="service",
            name=options.name,
            scene=options.scene,
            settings=options.settings,
            status=lambda: health.status(election),
            ready_file=options.ready_file,
            session_id=session_id,
            has_token=election is not None,
        ) as component,
        ExitStack() as stack,
    ):
        leadership = election or stack.enter_context(Presence(component))
        for space, camera in options.config.linking.cameras.items():
            _log.info("linking %s to bodies in %s", space, camera.frame)
        if not _warm_up(component, options.config):
            return
        # After the warm-up: the state is tried out before it is trusted.
        fusion = _make_fusion(options, session_id)
        if isinstance(leadership, Presence):
            leadership.require()
        keeper = None
        if options.state is not None:
            keeper = stack.enter_context(StateKeeper(options.state, to_ns(options.state_interval), fusion))
        clocks = SourceClocks(component, correct=options.correct_clocks)
        loop = Loop(fusion, component, leadership, health, keeper, clocks, recorded=options.clock == "event")
        # Last: a service that is not ready must not be elected; one that stops gives the scene back first.
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
    if not options.etcd:
        return None
    etcd = Etcd(options.etcd, options.etcd_tls)
    return Election(etcd, options.scene, options.name, session_id, lease=options.lease)


def _warm_up(component: Component, config: FusionConfig) -> bool:
    """Compile and import what the method needs; False if the process was stopped meanwhile."""
    notice_s = time.monotonic() + _LONG_WARM_UP_S
    for _ in prepare(config):
        if component.stop.is_set():
            return False
        if time.monotonic() > notice_s:
            _log.info("preparing the methods: the first start compiles them for half a minute or more")
            notice_s = inf
    return True
