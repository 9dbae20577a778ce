"""Publishes streams live to a scene: one source per stream."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from comotion_schemas import DEFAULT_SCENE
from comotion_schemas.transport import SessionSettings

from .player import Player, Progress, Schedule
from .runtime import SourcePublisher
from .streams import Stream


def publish(
    streams: Sequence[Stream],
    schedule: Schedule,
    *,
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    ready_file: Path | None = None,
    publish_sigma: bool = False,
    message: str = "",
    progress: Progress | None = None,
) -> None:
    """Publish streams as sources of a scene until they end, a signal arrives or the schedule ends.

    Parameters
    ----------
    streams
        One per source.
    schedule
        When frames are due, and their stamps.
    scene, settings, ready_file
        As in :class:`comotion_schemas.component.Component`.
    publish_sigma
        Publish the noise if a frame has it.
    message
        One line for Status.
    progress
        Called at every frame.

    Raises
    ------
    ValueError
        If the name of the scene or a source is not valid.
    """
    with ExitStack() as stack:
        publishers = []
        for number, stream in enumerate(streams, 1):
            publisher = SourcePublisher(
                stream.name,
                space=stream.space,
                unit=stream.unit,
                dim=stream.dim,
                scene=scene,
                settings=settings,
                ready_file=ready_file if number == len(streams) else None,
                rate=stream.rate * schedule.pace,
                message=message,
            )
            publishers.append(stack.enter_context(publisher))
        # Signals reach the component that was entered last.
        player = Player(
            streams,
            publishers,
            schedule,
            publishers[-1].stop,
            publish_sigma=publish_sigma,
            progress=progress,
        )
        publishers[-1].ready()
        player.run()
