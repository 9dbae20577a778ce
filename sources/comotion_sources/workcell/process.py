"""The workcell process: moves a scene by the clock and publishes its joint states.

All bodies of a workcell are attached to joints (free bodies to slides and hinges), so one message per
instant holds the state of the robot and of all bodies. Scene time is the wall clock modulo the period
of the scene: a restarted process continues at the right place.
"""

import logging
import time
from typing import Unpack

from comotion_schemas import JointStates, encode
from comotion_schemas.component import Component, Rates, StatusFields, Where
from comotion_schemas.text import counted
from comotion_schemas.transport import stream_publisher

from .scene import Scene

_MAX_DELAY_NS = 50_000_000
"""A state that is published later than this after its stamp is left out: cameras no longer wait for it."""
_log = logging.getLogger(__name__)


def run(
    workcell: Scene,
    *,
    rate: float = 200.0,
    duration: float | None = None,
    name: str = "workcell",
    **where: Unpack[Where],
) -> None:
    """Publish the joint states of a workcell until a signal arrives or the duration ends.

    `rate` is in joint states per second, `duration` in s, None: no end; `name` is that of the stream of joint
    states.
    """
    rates, counters = Rates(), {"batches": 0, "overruns": 0}
    text = f"workcell {workcell.name}, {workcell.model.njnt} joints"

    def status() -> StatusFields:
        return StatusFields(
            rates=rates.of({"joints": counters["batches"]}), counters=dict(counters), message=text
        )

    # Not "source": the service reports sources that publish no observations.
    with Component(role="viewer", name=name, status=status, **where) as component:
        publisher = stream_publisher(component.session, component.keys, "joints", name)
        component.ready()
        until = float("inf") if duration is None else time.monotonic() + duration
        period_ns, cycle_ns = round(1e9 / rate), round(workcell.period * 1e9)
        index = time.time_ns() // period_ns + 1
        while time.monotonic() < until:
            stamp = index * period_ns
            if component.stop.wait(max(0.0, (stamp - time.time_ns()) * 1e-9)):
                break
            message = JointStates(
                source=name,
                session=component.session_id,
                seq=counters["batches"],
                stamp_ns=stamp,
                names=list(workcell.joints),
                positions=workcell.configuration((stamp % cycle_ns if cycle_ns else stamp) * 1e-9),
            )
            publisher.put(encode(message))
            counters["batches"] += 1
            due = max(index + 1, (time.time_ns() - _MAX_DELAY_NS) // period_ns)
            counters["overruns"] += due - index - 1
            index = due
        publisher.undeclare()
    if counters["overruns"]:
        _log.warning("%s left out: late", counted(counters["overruns"], "instant"))
