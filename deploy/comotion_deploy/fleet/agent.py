"""The agent of a host: claims places in etcd, and runs the replicas of the places it holds.

Each pass renews the agent's lease and, if an entry has changed, does this agent's part of the plan. What an
agent runs ends with it. While etcd does not answer, everything goes on as it is.
"""

import logging
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from comotion.runtime.standby.etcd import Etcd, EtcdUnavailableError
from comotion_schemas.component import stop_on_signals
from comotion_schemas.readiness import announce_ready

from ..errors import UserError
from ..launcher import Child, WriteLine, log_lines
from ..processes import ProcessSpec, comotion
from . import entries
from .plan import Fleet, Place, Scene, claims, may_change, releases

# s; a host that is lost gives its places free after this time.
LEASE_S = 3
_PASS_S = 0.5
_log = logging.getLogger(__name__)


@dataclass
class _Running:
    """The processes of one place; `leaving`: they have been stopped, and the place goes with them."""

    children: list[Child]
    scene: Scene
    announced: bool = False
    leaving: bool = False
    stopped_s: float = 0.0


def run_agent(
    name: str, capacity: int, etcd: Etcd, options: Sequence[str], *, log: Path | None, ready_file: Path | None
) -> None:
    """Run an :class:`Agent` until SIGINT or SIGTERM; its lines go to `log`, or to standard output."""
    stop = threading.Event()
    with (
        TemporaryDirectory(prefix="comotion-fleet-") as folder,
        log_lines([name], log) as write,
        stop_on_signals(stop),
    ):
        Agent(name, capacity, etcd, options, Path(folder), write).run(stop, ready_file)


@dataclass
class Agent:
    """One agent.

    Raises
    ------
    UserError
        By :meth:`run`, if another agent of this name lives.
    """

    name: str  # unique in the fleet
    capacity: int  # how many replicas its host can run
    etcd: Etcd  # the cluster
    options: Sequence[str]  # of ``comotion serve`` on this host, such as ``--connect``
    # Where the processes say that they are ready, and where their lines go.
    folder: Path
    write: WriteLine

    def __post_init__(self) -> None:
        self._lease: int | None = None
        self._followed = -1
        self._running: dict[Place, _Running] = {}
        self._away = False

    def run(self, stop: threading.Event, ready_file: Path | None) -> None:
        """Work until `stop` is set; then stop all processes and give up all places.

        It says that it is ready when it is known to the fleet.
        """
        registered = False
        with ExitStack() as ready:
            try:
                while not stop.is_set():
                    began = time.monotonic()
                    if self._pass() and not registered:
                        registered = True
                        ready.enter_context(announce_ready(ready_file))
                    stop.wait(max(0.0, began + _PASS_S - time.monotonic()))
            finally:
                self._leave()

    def _pass(self) -> bool:
        """Kill what does not stop, then do what etcd says; whether it has answered."""
        for running in self._running.values():
            for child in running.children if running.leaving else ():
                if time.monotonic() > running.stopped_s + child.spec.stop_s:
                    child.wait(running.stopped_s)
        try:
            lease = self._renew()
            # Where nothing has changed there is nothing to do; all entries of a large fleet are much to read.
            if self.etcd.revision != self._followed:
                fleet = entries.read_fleet(self.etcd)
                revision = self.etcd.revision
                self._follow(fleet, lease)
                self._followed = revision
            self._report(lease)
        except EtcdUnavailableError as error:
            if not self._away:
                _log.warning("%s; what runs here goes on", error)
            self._away = True
            return False
        if self._away:
            _log.info("etcd answers again")
        self._away = False
        return True

    def _renew(self) -> int:
        if self._lease is not None and self.etcd.renew(self._lease):
            return self._lease
        lost, self._lease = self._lease is not None, self.etcd.grant(LEASE_S)
        if not entries.register(self.etcd, self.name, self.capacity, self._lease):
            self._lease = None
            raise UserError(f"an agent {self.name!r} is there already; choose another --name")
        if lost:
            _log.warning("the lease had ended; claiming the %d places again", len(self._running))
        for place, running in self._running.items() if lost else ():
            # Keep what nobody else has claimed meanwhile.
            if not entries.claim(self.etcd, place, self.name, self._lease):
                self._stop(place, running, "another agent has it")
            running.announced = False
        return self._lease

    def _follow(self, fleet: Fleet, lease: int) -> None:
        held, wanted = fleet.held(), set(fleet.places())
        for place, running in self._running.items():
            if place not in wanted:
                self._stop(place, running, "removed")
        for place, why in self._given_up(fleet).items():
            running = self._running[place]
            running.announced = False
            if entries.say_leaving(self.etcd, place, held[place], held.get(place.other), lease):
                self._stop(place, running, why)
        for place, agent in claims(fleet).items():
            free = agent == self.name and place not in self._running
            if free and entries.claim(self.etcd, place, self.name, lease):
                self._start(place, fleet.scenes[place.scene])

    def _given_up(self, fleet: Fleet) -> dict[Place, str]:
        """The places of this agent whose replicas should stop, and why."""
        held = fleet.held()
        reasons = dict.fromkeys(releases(fleet), "moves to another host")
        for place, running in self._running.items():
            if place in held and running.scene != fleet.scenes[place.scene] and may_change(fleet, place):
                reasons.setdefault(place, "changed")
        staying = {p for p, running in self._running.items() if not running.leaving}
        return {p: why for p, why in reasons.items() if p in staying and held[p].agent == self.name}

    def _report(self, lease: int) -> None:
        """Say what is ready, and give up the places whose processes have stopped."""
        for place, running in list(self._running.items()):
            if running.leaving and not any(child.is_alive() for child in running.children):
                entries.release(self.etcd, place, lease)
                del self._running[place]
            elif not (running.leaving or running.announced) and running.children[0].was_ready:
                entries.say_ready(self.etcd, place, self.name, running.scene.version, lease)
                running.announced = True

    def _start(self, place: Place, scene: Scene) -> None:
        log = partial(self.write, self.name)
        children = [Child(spec, self.folder, self.write, log) for spec in self._specs(place, scene)]
        self._running[place] = _Running(children, scene)
        for child in children:
            child.start()
        _log.info("runs scene %s, replica %d", place.scene, place.number)

    def _specs(self, place: Place, scene: Scene) -> list[ProcessSpec]:
        name = f"{place.scene}-{place.number}"
        served = ["serve", "--scene", place.scene, "--name", f"{self.name}-{place.number}"]
        replica = ["--standby", "--etcd", ",".join(self.etcd.urls)]
        specs = [comotion(name, *served, *replica, *self.options, *scene.serve, restart="always")]
        for k, also in enumerate(scene.also if place.number == 0 else ()):
            words = [*also.split(), "--scene", place.scene, *self.options]
            specs.append(comotion(f"{name}-also{k}", *words, restart="on-failure"))
        return specs

    def _stop(self, place: Place, running: _Running, why: str) -> None:
        if running.leaving:
            return
        _log.info("stops scene %s, replica %d: %s", place.scene, place.number, why)
        running.leaving, running.stopped_s = True, time.monotonic()
        for child in running.children:
            child.terminate()

    def _leave(self) -> None:
        """Stop everything, then end the lease: the places are free."""
        for place, running in self._running.items():
            self._stop(place, running, "this agent stops")
        for running in self._running.values():
            for child in running.children:
                child.wait(running.stopped_s)
        if self._lease is not None:
            try:
                self.etcd.revoke(self._lease)
            except EtcdUnavailableError as error:
                _log.warning("could not give up the places: %s", error)
