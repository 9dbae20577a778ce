"""The workcell as a process: drives the scene and publishes its joint states.

Every body of a workcell hangs on joints (free bodies on slides and hinges), so one message per
instant holds the joint states of the robot and the states of all bodies alike. Scene time is the
wall clock modulo the period of the scene: a restarted process goes on where the scene would be.
"""

import logging
import time
from collections.abc import Callable
from pathlib import Path

from comotion_schemas import DEFAULT_SCENE, JointStates, encode
from comotion_schemas.component import Component, StatusFields
from comotion_schemas.transport import Publisher, SessionSettings, stream_publisher

from .scene import Scene

_LATE_NS = 50_000_000
"""A state is a fact of its stamp and as good a little later; one this late has nobody waiting for it."""
_log = logging.getLogger(__name__)


class _Driver:
    """Publishes one instant after the other and counts them."""

    def __init__(self, workcell: Scene, rate: float, name: str) -> None:
        self._scene, self._name = workcell, name
        self._period_ns = round(1e9 / rate)
        self._seq = self.overruns = 0
        self._before = (time.monotonic(), 0)

    def status(self) -> StatusFields:
        """What the process tells about itself."""
        now, seq = time.monotonic(), self._seq
        before, count = self._before
        self._before = (now, seq)
        return StatusFields(
            rates={"joints": (seq - count) / (now - before) if now > before else 0.0},
            counters={"batches": seq, "overruns": self.overruns},
            message=f"workcell {self._scene.name}, {self._scene.model.njnt} joints",
        )

    def run(self, publisher: Publisher, session: str, wait: Callable[[float], bool], until: float) -> None:
        """Publish at multiples of the period on the clock until told to stop; very late ones are left out."""
        index = time.time_ns() // self._period_ns + 1
        while time.monotonic() < until:
            stamp = index * self._period_ns
            if wait(max(0.0, (stamp - time.time_ns()) * 1e-9)):
                return
            message = joint_states(self._scene, stamp, source=self._name, session=session, seq=self._seq)
            publisher.put(encode(message))
            self._seq += 1
            due = max(index + 1, (time.time_ns() - _LATE_NS) // self._period_ns)
            self.overruns += due - index - 1
            index = due


def joint_states(scene: Scene, stamp_ns: int, *, source: str, session: str, seq: int) -> JointStates:
    """Build the joint states of a scene at a stamp: t = stamp modulo the period."""
    period_ns = round(scene.period * 1e9)
    t = (stamp_ns % period_ns if period_ns else stamp_ns) * 1e-9
    return JointStates(
        source=source,
        session=session,
        seq=seq,
        stamp_ns=stamp_ns,
        names=list(scene.joints),
        positions=scene.configuration(t),
    )


def run(
    workcell: Scene,
    *,
    rate: float = 200.0,
    duration: float | None = None,
    name: str = "workcell",
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    ready_file: Path | None = None,
) -> None:
    """Drive a workcell until a signal or the end of `duration` (seconds) stops it.

    Parameters
    ----------
    workcell
        The workcell's scene.
    rate
        Joint states per second.
    name
        Of the stream of joint states.
    scene, settings, ready_file
        As in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If scene or name is no valid chunk of a key.
    """
    driver = _Driver(workcell, rate, name)
    component = Component(
        # Not "source": it publishes no observations, and the service would miss them.
        role="viewer",
        name=name,
        scene=scene,
        settings=settings,
        status=driver.status,
        ready_file=ready_file,
    )
    with component:
        publisher = stream_publisher(component.session, component.keys, "joints", name)
        component.ready()
        until = float("inf") if duration is None else time.monotonic() + duration
        driver.run(publisher, component.session_id, component.stop.wait, until)
        publisher.undeclare()
        if driver.overruns:
            _log.warning("%d instants were late and have been left out", driver.overruns)
