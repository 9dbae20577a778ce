"""The replay process: publishes a recording live, as one source or several."""

import dataclasses
import logging
from collections.abc import Sequence
from typing import Literal, Unpack

from comotion_schemas.component import Where
from comotion_schemas.errors import KnownError

from .parts import Part
from .playback import publish, replay_keys, shown_progress
from .player import Schedule
from .recordings import Recording, recording_streams
from .streams import Stream

Stamps = Literal["now", "original"]
_log = logging.getLogger(__name__)


def choose_streams(
    recording: Recording,
    *,
    split: int = 1,
    part: Part | None = None,
    rates: Sequence[float] | None = None,
    name: str | None = None,
    speed: float = 1.0,
    stamps: Stamps = "now",
) -> list[Stream]:
    """Build the streams that one process publishes.

    Parameters
    ----------
    recording
        The recording.
    split
        Number of sources that share the markers; this process publishes all of them.
    part
        Publish only this part instead; other processes publish the other parts.
    rates
        Hz, as in :func:`recording_streams`.
    name
        Name of the source; if the process publishes several, the k-th is ``<name>-k``.
    speed
        Recorded seconds per second, above 0 and at most 1000.
    stamps
        ``now``: wall clock, so that velocities scale with `speed`; ``original``: those of the
        recording.

    Raises
    ------
    ValueError
        If a rate is above that of the recording, the number of rates is wrong, or the speed is out of
        range.
    """
    if not 0 < speed <= 1000:
        raise KnownError(f"speed {speed:g} is not within 0 to 1000")
    count = split if part is None else part.count
    streams = recording_streams(
        recording,
        split=count,
        rates=rates,
        source=name or "replay",
        time_scale=1.0 / speed if stamps == "now" else 1.0,
    )
    if part is None:
        return streams
    mine = streams[part.index]
    return [mine if name is None else dataclasses.replace(mine, name=name)]


def schedule(
    *, speed: float, stamps: Stamps, loop: bool, duration: float | None, start_at: float | str
) -> Schedule:
    """Build the schedule for the streams of :func:`choose_streams`, with the same `speed` and `stamps`."""
    live = stamps == "now"
    return Schedule(
        start_at=start_at,
        loop=loop,
        pace=1.0 if live else speed,
        live_stamps=live,
        duration=duration,
    )


def run(
    recording: Recording,
    streams: Sequence[Stream],
    when: Schedule,
    **where: Unpack[Where],
) -> None:
    """Publish until the recording ends, a signal arrives or the schedule ends.

    Parameters
    ----------
    recording
        The recording, for messages.
    streams, when
        Its streams and their schedule.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If the name of the scene or a source is not valid.
    """
    _log.info(
        "%s: %d instants at %.4g Hz, %d %s%s; as %s",
        recording.name,
        len(recording),
        recording.rate,
        recording.positions.shape[1],
        "markers in m" if recording.dim == 3 else "tracks in px",
        "" if recording.labels is None else " with truth",
        ", ".join(f"{stream.name} at {stream.rate:.4g} Hz" for stream in streams),
    )
    with shown_progress(recording.name, streams[0].length) as progress:
        publish(
            streams,
            when,
            publish_sigma=True,
            message=f"replays {recording.name}",
            progress=progress,
            keys=replay_keys(),
            **where,
        )
