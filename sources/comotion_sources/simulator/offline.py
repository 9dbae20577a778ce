"""Simulations -> streams of messages, without processes or clocks."""

from collections.abc import Iterator, Sequence

from comotion_schemas import ObservationBatch, TruthBatch

from ..streams import Stream, merged, numbered
from .simulation import Simulation

DEFAULT_NAME = "simulator"


def streams(simulations: Sequence[Simulation], name: str | None = None) -> list[Stream]:
    """Build the streams of simulated sources, to be played live or offline.

    Parameters
    ----------
    simulations
        The sources.
    name
        Name of the source; with several sources, the k-th is ``<name>-k``. None: ``simulator``, or
        ``simulator-k`` for part k of several.
    """
    return [
        _stream(
            simulation,
            numbered(DEFAULT_NAME, simulation.part.index, simulation.part.count)
            if name is None
            else numbered(name, k, len(simulations)),
        )
        for k, simulation in enumerate(simulations)
    ]


def _stream(simulation: Simulation, name: str) -> Stream:
    spec = simulation.spec
    return Stream(
        name=name,
        space=spec.space,
        unit=spec.unit,
        dim=spec.dim,
        objects=simulation.object_names,
        rate=simulation.rate,
        length=simulation.duration,
        frames=simulation,
    )


def batches(
    simulations: Simulation | Sequence[Simulation],
    *,
    epoch_ns: int = 0,
    publish_sigma: bool = False,
) -> Iterator[TruthBatch | ObservationBatch]:
    """Yield the messages of simulated sources in time order: the truth of features, then observations.

    Parameters
    ----------
    simulations
        One source, or several of the same scene.
    epoch_ns
        Stamp of the start of the scene, nanoseconds since the Unix epoch.
    publish_sigma
        Publish the true noise of every feature.
    """
    chosen = [simulations] if isinstance(simulations, Simulation) else simulations
    return merged(streams(chosen), epoch_ns=epoch_ns, publish_sigma=publish_sigma)
