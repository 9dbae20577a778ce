"""The simulator process: publishes a scene live, as one source or several."""

import dataclasses
from collections.abc import Sequence
from typing import Unpack

from comotion_schemas.component import Where

from ..replay import play_streams
from ..streams import numbered
from ..tape import Schedule
from .offline import stream
from .simulation import Simulation


def run(
    simulations: Sequence[Simulation],
    schedule: Schedule,
    *,
    name: str | None = None,
    publish_sigma: bool = False,
    **where: Unpack[Where],
) -> None:
    """Publish simulated sources until the scene ends, a signal arrives or the schedule ends.

    Parameters
    ----------
    simulations
        The sources.
    schedule
        When frames are due, and their stamps.
    name
        Name of the source; with several sources, the k-th is ``<name>-k``.
    publish_sigma
        Publish the true noise of every feature.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If the name of the scene or a source is not valid.
    """
    streams = [stream(simulation) for simulation in simulations]
    if name is not None:
        streams = [
            dataclasses.replace(source, name=numbered(name, k, len(streams)))
            for k, source in enumerate(streams)
        ]
    play_streams(
        streams,
        schedule,
        message=f"simulates {simulations[0].spec.title}",
        publish_sigma=publish_sigma,
        **where,
    )
