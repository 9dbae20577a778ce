"""Streams: the frames of sources -> the messages that live processes would publish, in time order."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.types import Unit

from .frames import Batcher, Frame, MessageBuilder, in_time_order

OFFLINE_SESSION = "0" * 16


def numbered(name: str, part: int, parts: int) -> str:
    """Name of one of several sources: ``name-1`` for part 0; with one source, `name` itself."""
    return name if parts == 1 else f"{name}-{part + 1}"


@dataclass(frozen=True, kw_only=True)
class Stream:
    """The frames of one source with their coordinate space and rate.

    Attributes
    ----------
    name
        Name of the source.
    space, unit, dim
        The coordinate space of the positions.
    objects
        Names of the true objects by number.
    rate
        Frames per second.
    length
        Seconds after which the stream may be repeated; then frames at or after this time are left out.
    frames
        The frames; iterated once per pass.
    """

    name: str
    space: str
    unit: Unit
    dim: int
    objects: Mapping[int, str]
    rate: float
    length: float
    frames: Iterable[Frame]

    def builder(self, session: str) -> MessageBuilder:
        """Return the message builder for one session of this source."""
        return MessageBuilder(
            source=self.name, session=session, space=self.space, unit=self.unit, dim=self.dim
        )


def merged(
    streams: Sequence[Stream],
    *,
    session: str = OFFLINE_SESSION,
    epoch_ns: int = 0,
    publish_sigma: bool = False,
) -> Iterator[TruthBatch | ObservationBatch]:
    """Yield the messages of all streams in time order.

    Parameters
    ----------
    streams
        One per source, with different names.
    session
        Session of every source, 16 hexadecimal digits.
    epoch_ns
        Stamp of t = 0, nanoseconds since the Unix epoch.
    publish_sigma
        Publish the noise if a frame has it.
    """
    batchers = [
        Batcher(
            stream.builder(session),
            objects=stream.objects,
            epoch_ns=epoch_ns,
            publish_sigma=publish_sigma,
        )
        for stream in streams
    ]
    for index, frame in in_time_order([stream.frames for stream in streams]):
        yield from batchers[index].messages(frame)
