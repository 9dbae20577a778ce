"""Frames, the messages of a session of a source, and those of several sources in one order of time. Pure.

Simulations and recordings of features are streams. They are pure, so a live process and an offline
evaluation have the same content.
"""

import heapq
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comotion_schemas import ObservationBatch, TruthBatch, encode
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import Kind
from comotion_schemas.types import Unit

AMBIGUOUS = -1
"""Object number of a feature that is never scored."""
OFFLINE_SESSION = "0" * 16
Published = TruthBatch | ObservationBatch


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The observations of one source at one instant."""

    t: float  # seconds since the start of the source
    ids: NDArray[np.uint64]  # uint64 [N]
    positions: NDArray[np.float64]  # float64 [N, dim], in the unit of the source
    # int32 [N], true object of each feature, :data:`AMBIGUOUS` when unknown; None without truth.
    objects: NDArray[np.int32] | None = None
    # uint64 [M], ids lost for good since the frame before.
    ended: NDArray[np.uint64] = field(default_factory=lambda: np.empty(0, np.uint64))
    # float64 [N], true one-sigma noise, in the unit of the source; None when unknown.
    sigma: NDArray[np.float64] | None = None
    # float64 [N, 4] (x, y, z, w), rows of NaN for points; None when there are only points.
    quaternions: NDArray[np.float64] | None = None


@dataclass(kw_only=True)
class MessageBuilder:
    """Builds the messages of one session of a source; batches are numbered from 0."""

    # Name of the source and 16 hexadecimal digits.
    source: str
    session: str
    # The coordinate space of the positions.
    space: str
    unit: Unit
    dim: int
    moving: bool = False  # whether its frame is carried, as that of a camera in the hand
    seq: int = field(default_factory=int, init=False)

    def observation(self, **columns: Any) -> ObservationBatch:
        """Build the next batch; `columns` are the other fields of :class:`ObservationBatch`, as array-likes.

        Raises
        ------
        pydantic.ValidationError
            If the arrays are malformed; the sequence number is then not used.
        """
        batch = ObservationBatch(**vars(self) | {"moving": self.moving or None}, **columns)
        self.seq += 1
        return batch

    def truth(self, *, ids: ArrayLike, objects: ArrayLike, names: Mapping[int, str]) -> TruthBatch:
        """Build a truth batch.

        Parameters
        ----------
        ids
            uint64 [N], features.
        objects
            int32 [N], their true objects, -1 for ambiguous.
        names
            Object number -> name; names of other objects are left out.

        Raises
        ------
        pydantic.ValidationError
            If the arrays are malformed.
        """
        numbers = np.asarray(objects, np.int32)
        named = {str(n): names[n] for n in np.unique(numbers).tolist() if n in names}
        return TruthBatch(
            source=self.source, session=self.session, ids=np.asarray(ids), objects=numbers, names=named
        )


@dataclass(frozen=True)
class Part:
    """Source number `index` (from 0) of `count` sources."""

    index: int = 0
    count: int = 1


def parse_part(text: str | None) -> Part | None:
    """Parse ``k/n``: the k-th of n sources, counted from 1; None, or no text: all of them.

    Raises
    ------
    ValueError
        If the text does not have this form.
    """
    if not text:
        return None
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second) <= 64:
        return Part(int(first) - 1, int(second))
    raise KnownError(f"part {text!r} is not K/N with 1 <= K <= N <= 64, e.g. 2/3")


def parse_rates(text: str | None) -> list[float] | None:
    """Parse rates in Hz, separated by commas; None, or no text: none are given.

    Raises
    ------
    ValueError
        If a rate is not a number above 0 and at most 1000.
    """
    if not text:
        return None
    try:
        rates = [float(chunk) for chunk in text.split(",")]
    except ValueError:
        rates = []
    if not rates or not all(0 < rate <= 1000 for rate in rates):
        raise KnownError(f"rate {text!r} is not one or several numbers from 0 to 1000 Hz, e.g. 15,30,100")
    return rates


def rate_of(part: Part, rates: Sequence[float]) -> float:
    """Return the rate of a part, in Hz: its own, or the common one.

    Raises
    ------
    ValueError
        If the number of rates is neither one nor the number of parts.
    """
    if len(rates) not in {1, part.count}:
        raise KnownError(f"{len(rates)} rates for {part.count} sources; give one, or one for each")
    return rates[part.index % len(rates)]


def numbered(name: str, part: int, parts: int) -> str:
    """Name of one of several sources: ``name-1`` for part 0; with one source, `name` itself."""
    return name if parts == 1 else f"{name}-{part + 1}"


@dataclass(frozen=True, slots=True)
class StreamMessage:
    """A message of a stream as an entry of a log; truth has the time of the frame that it goes with."""

    kind: Kind
    log_ns: int
    message: Published

    @property
    def name(self) -> str:
        """Name of the source."""
        return self.message.source

    @property
    def payload(self) -> bytes:
        """The message as bytes."""
        return encode(self.message)

    def decode(self) -> Published:
        """The message."""
        return self.message


class Stream:
    """The frames of one source, which it iterates over once per pass.

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
    publish_sigma
        Whether the noise of a frame that has it is published.
    """

    name: str
    space: str
    unit: Unit
    dim: int
    objects: Mapping[int, str]
    rate: float
    length: float
    publish_sigma = False

    def __iter__(self) -> Iterator[Frame]:
        raise NotImplementedError

    def messages(self, session: str, epoch_ns: int = 0) -> Iterator[StreamMessage]:
        """Yield the messages of one session: the truth of features before their first observation.

        The parameters are those of :func:`batches`.
        """
        builder = MessageBuilder(
            source=self.name, session=session, space=self.space, unit=self.unit, dim=self.dim
        )
        born: set[int] = set()
        for frame in self:
            newborn = np.array([identity not in born for identity in frame.ids.tolist()], bool)
            born.update(frame.ids[newborn].tolist())
            stamp_ns = epoch_ns + round(frame.t * 1e9)
            if frame.objects is not None and newborn.any():
                truth = builder.truth(
                    ids=frame.ids[newborn], objects=frame.objects[newborn], names=self.objects
                )
                yield StreamMessage("truth", stamp_ns, truth)
            published = frame.sigma if self.publish_sigma and frame.sigma is not None else np.empty(0)
            values = np.unique(published)
            noise = float(values[0]) if len(values) == 1 else published
            batch = builder.observation(
                stamp_ns=stamp_ns,
                ids=frame.ids,
                positions=frame.positions,
                sigma=noise if len(values) and (values > 0).all() else None,
                quaternions=frame.quaternions,
                ended=frame.ended if frame.ended.size else None,
            )
            yield StreamMessage("obs", stamp_ns, batch)


def batches(streams: Stream | Sequence[Stream], *, epoch_ns: int = 0) -> Iterator[Published]:
    """Yield the messages of all streams in time order; at equal times in the order of the streams.

    The streams, one per source, have different names; `epoch_ns` is the stamp of t = 0, nanoseconds since the
    Unix epoch.
    """
    chosen = [streams] if isinstance(streams, Stream) else streams
    log = StreamLog(chosen, OFFLINE_SESSION, epoch_ns)
    for logged in log.messages():
        yield logged.message


class StreamLog:
    """Streams as a log to play; the parameters are those of :func:`batches`."""

    gap_s = 0.0
    """Seconds between two passes, beyond the length."""

    def __init__(self, streams: Sequence[Stream], session: str, epoch_ns: int = 0) -> None:
        self._streams, self._session = streams, session
        self.start_ns = epoch_ns
        self.end_ns = epoch_ns + round(1e9 * max(stream.length for stream in streams))

    def messages(
        self, kinds: Collection[Kind] | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[StreamMessage]:
        """Yield the messages of some kinds in a range of time, in time order."""
        streams = (stream.messages(self._session, self.start_ns) for stream in self._streams)
        for entry in heapq.merge(*streams, key=lambda entry: entry.log_ns):
            if end_ns is not None and entry.log_ns > end_ns:
                return
            if (kinds is None or entry.kind in kinds) and (start_ns is None or entry.log_ns >= start_ns):
                yield entry
