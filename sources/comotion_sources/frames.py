"""Frames of one source -> its messages.

Simulations and recordings yield :class:`Frame`; :class:`Batcher` builds the messages of one source.
Both are pure, so a live process and an offline evaluation send the same content.
"""

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.types import Unit

NANOSECONDS = 1_000_000_000
AMBIGUOUS = -1
"""Object number of a feature that is never scored."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """The observations of one source at one instant.

    Attributes
    ----------
    t
        Seconds since the start of the source.
    ids
        uint64 [N].
    positions
        float64 [N, dim], in the unit of the source.
    objects
        int32 [N], true object of each feature, :data:`AMBIGUOUS` when unknown; None without truth.
    ended
        uint64 [M], ids lost for good since the frame before.
    sigma
        float64 [N], true one-sigma noise, in the unit of the source; None when unknown.
    quaternions
        float64 [N, 4] (x, y, z, w), rows of NaN for points; None when there are only points.
    """

    t: float
    ids: NDArray[np.uint64]
    positions: NDArray[np.float64]
    objects: NDArray[np.int32] | None = None
    ended: NDArray[np.uint64] = field(default_factory=lambda: np.empty(0, np.uint64))
    sigma: NDArray[np.float64] | None = None
    quaternions: NDArray[np.float64] | None = None


class MessageBuilder:
    """Builds the messages of one session of a source; batches are numbered from 0.

    Parameters
    ----------
    source, session
        Name of the source and 16 hexadecimal digits.
    space, unit, dim
        The coordinate space of the positions.
    moving
        Whether its frame is carried, as that of a camera in the hand.
    """

    def __init__(
        self, *, source: str, session: str, space: str, unit: Unit, dim: int, moving: bool = False
    ) -> None:
        self.source, self.session = source, session
        self._space, self._unit, self._dim = space, unit, dim
        self._moving = True if moving else None
        self._seq = 0

    def observation(self, **columns: Any) -> ObservationBatch:
        """Build the next batch; `columns` are the other fields of :class:`ObservationBatch`, as array-likes.

        Raises
        ------
        pydantic.ValidationError
            If the arrays are malformed; the sequence number is then not used.
        """
        batch = ObservationBatch(
            source=self.source,
            session=self.session,
            seq=self._seq,
            space=self._space,
            unit=self._unit,
            dim=self._dim,
            moving=self._moving,
            **columns,
        )
        self._seq += 1
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


class Batcher:
    """Builds the messages of one session of a source from its frames.

    The truth of a feature is sent once, before its first observation.

    Parameters
    ----------
    builder
        The source and its session.
    objects
        Names of the objects by number.
    epoch_ns
        Acquisition time of t = 0, nanoseconds since the Unix epoch.
    publish_sigma
        Publish the noise if a frame has it.
    """

    def __init__(
        self,
        builder: MessageBuilder,
        *,
        objects: Mapping[int, str],
        epoch_ns: int = 0,
        publish_sigma: bool = False,
    ) -> None:
        self._builder = builder
        self._objects = objects
        self.epoch_ns = epoch_ns
        self._publish_sigma = publish_sigma
        self._known: set[int] = set()
        self._ended: list[NDArray[np.uint64]] = []

    def messages(self, frame: Frame) -> Iterator[TruthBatch | ObservationBatch]:
        """Build the messages of a frame: the truth of newborn features if any, then the batch."""
        newborn = np.array([identity not in self._known for identity in frame.ids.tolist()], bool)
        self._known.update(frame.ids[newborn].tolist())
        if frame.objects is not None and newborn.any():
            yield self._builder.truth(
                ids=frame.ids[newborn], objects=frame.objects[newborn], names=self._objects
            )
        ended = np.concatenate([*self._ended, frame.ended])
        self._ended.clear()
        yield self._builder.observation(
            stamp_ns=self.epoch_ns + round(frame.t * NANOSECONDS),
            ids=frame.ids,
            positions=frame.positions,
            sigma=_sigma(frame) if self._publish_sigma else None,
            quaternions=frame.quaternions,
            ended=ended if ended.size else None,
        )

    def skip(self, frame: Frame) -> None:
        """Leave a frame out; the next frame reports the features that ended in it."""
        self._ended.append(frame.ended)


def _sigma(frame: Frame) -> float | NDArray[np.float64] | None:
    """Noise of a frame: one number if all features have the same; None if unknown or zero."""
    sigma = frame.sigma
    if sigma is None or not sigma.size or not (sigma > 0).all():
        return None
    return float(sigma[0]) if bool((sigma == sigma[0]).all()) else sigma


def in_time_order(sources: Sequence[Iterable[Frame]]) -> Iterator[tuple[int, Frame]]:
    """Merge the frames of several sources by time; equal times in the order of the sources.

    Yields
    ------
    Index of the source, and frame.
    """

    def tagged(index: int, frames: Iterable[Frame]) -> Iterator[tuple[float, int, Frame]]:
        return ((frame.t, index, frame) for frame in frames)

    streams = [tagged(index, frames) for index, frames in enumerate(sources)]
    for _, index, frame in heapq.merge(*streams, key=lambda item: item[:2]):
        yield index, frame
