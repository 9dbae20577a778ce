"""The workcell process: moves a scene by the clock and publishes its joint states.

All bodies of a workcell are attached to joints (free bodies to slides and hinges), so one message per
instant holds the state of the robot and of all bodies. Scene time is the wall clock modulo the period
of the scene: a restarted process continues at the right place.
"""

import logging
import time
from collections.abc import Callable
from typing import Unpack

from comotion_schemas import JointStates, encode
from comotion_schemas.component import Component, Rates, StatusFields, Where
from comotion_schemas.text import counted
from comotion_schemas.transport import Publisher, stream_publisher

from .scene import Scene

_MAX_DELAY_NS = 50_000_000
"""A state that is published later than this after its stamp is left out: cameras no longer wait for it."""
_log = logging.getLogger(__name__)


class _Driver:
    """Publishes the joint states instant by instant and counts them."""

    def __init__(self, workcell: Scene, rate: float, name: str) -> None:
        self._scene, self._name = workcell, name
        self._period_ns = round(1e9 / rate)
        self._seq = self.overruns = 0
        self._rates = Rates()

    def status(self) -> StatusFields:
        """Build the Status of the process."""
        seq = self._seq
        return StatusFields(
            rates=self._rates.of({"joints": seq}),
            counters={"batches": seq, "overruns": self.overruns},
            message=f"workcell {self._scene.name}, {self._scene.model.njnt} joints",
        )

    def run(self, publisher: Publisher, session: str, wait: Callable[[float], bool], until: float) -> None:
        """Publish at multiples of the period on the wall clock until stopped."""
        index = time.time_ns() // self._period_ns + 1
        while time.monotonic() < until:
            stamp = index * self._period_ns
            if wait(max(0.0, (stamp - time.time_ns()) * 1e-9)):
                return
            message = joint_states(self._scene, stamp, source=self._name, session=session, seq=self._seq)
            publisher.put(encode(message))
            self._seq += 1
            due = max(index + 1, (time.time_ns() - _MAX_DELAY_NS) // self._period_ns)
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
    **where: Unpack[Where],
) -> None:
    """Publish the joint states of a workcell until a signal arrives or the duration ends.

    Parameters
    ----------
    workcell
        The scene of the workcell.
    duration
        Seconds; None: no end.
    rate
        Joint states per second.
    name
        Name of the stream of joint states.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If the name of the scene or stream is not valid.
    """
    driver = _Driver(workcell, rate, name)
    # Not "source": the service reports sources that publish no observations.
    with Component(role="viewer", name=name, status=driver.status, **where) as component:
        publisher = stream_publisher(component.session, component.keys, "joints", name)
        component.ready()
        until = float("inf") if duration is None else time.monotonic() + duration
        driver.run(publisher, component.session_id, component.stop.wait, until)
        publisher.undeclare()
        if driver.overruns:
            _log.warning("%s left out: late", counted(driver.overruns, "instant"))
