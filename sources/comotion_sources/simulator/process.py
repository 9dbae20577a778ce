"""The simulator process: publishes a scene live, as one source or several."""

import dataclasses
from collections.abc import Sequence
from typing import Unpack

from comotion_schemas.component import Where

from ..parts import Part, rate_of
from ..replay import play_streams
from ..streams import numbered
from ..tape import Schedule
from .offline import stream
from .simulation import Simulation, Split, simulate
from .spec import SceneSpec


def choose_sources(
    spec: SceneSpec,
    *,
    part: Part | None = None,
    rates: Sequence[float] | None = None,
    seed: int = 0,
    noise: float = 1.0,
    time_scale: float = 1.0,
    split: Split = "features",
) -> list[Simulation]:
    """Build the sources that one process publishes.

    Parameters
    ----------
    spec
        The scene.
    part
        Publish only this part; None: all parts.
    rates
        Hz of each source, or of all; None: those of the scene.
    seed, noise, time_scale, split
        As in :class:`Simulation`.

    Raises
    ------
    ValueError
        If the number of rates is wrong, or an argument is out of range.
    """
    options = {"seed": seed, "noise": noise, "time_scale": time_scale}
    if part is None:
        return simulate(spec, rates=rates, split=split, **options)  # type: ignore[arg-type]
    known = spec.rates if len(spec.rates) == part.count else [spec.rate]
    rate = rate_of(part, rates or known)
    return [Simulation(spec, rate=rate, part=part.index, parts=part.count, split=split, **options)]  # type: ignore[arg-type]


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
