"""What a source sees at one instant, and how that becomes messages.

Simulations and recordings yield :class:`Frame`; :class:`Batcher` turns frames into the messages of
one source. Both are pure, so a live process and an offline evaluation send the same content.
"""

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.types import Unit

NANOSECONDS = 1_000_000_000
AMBIGUOUS = -1
"""Object number of a feature that is never scored."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """What one source observes at one instant.

    Attributes
    ----------
    t
        Seconds since the source's start.
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


class Batcher:
    """Turns the frames of one source into its messages: one session, sequence numbers from 0.

    The truth of a feature goes out once, before the first observation of it.

    Parameters
    ----------
    source, session
        Name of the source and 16 hexadecimal digits.
    space, unit, dim
        The coordinate space of the positions.
    names
        Names of the objects by number.
    epoch_ns
        Acquisition time of t = 0, nanoseconds since the Unix epoch.
    publish_sigma
        Publish the noise where a frame knows it.
    """

    def __init__(
        self,
        *,
        source: str,
        session: str,
        space: str,
        unit: Unit,
        dim: int,
        names: Mapping[int, str] | None = None,
        epoch_ns: int = 0,
        publish_sigma: bool = False,
    ) -> None:
        self._source, self._session = source, session
        self._space, self._unit, self._dim = space, unit, dim
        self._names = dict(names or {})
        self._epoch_ns = epoch_ns
        self._publish_sigma = publish_sigma
        self._seq = 0
        self._known: set[int] = set()
        self._ended: list[NDArray[np.uint64]] = []

    def messages(self, frame: Frame) -> Iterator[TruthBatch | ObservationBatch]:
        """Build the messages of a frame: the truth of newborn features if any, then the batch."""
        truth = self._truth(frame)
        if truth is not None:
            yield truth
        yield self._batch(frame)

    def skip(self, frame: Frame) -> None:
        """Leave a frame out; features that ended in it are reported with the next one."""
        self._ended.append(frame.ended)

    def stamp_ns(self, t: float) -> int:
        """Acquisition time of the instant t, in nanoseconds since the Unix epoch."""
        return self._epoch_ns + round(t * NANOSECONDS)

    def _truth(self, frame: Frame) -> TruthBatch | None:
        if frame.objects is None:
            return None
        newborn = np.array([identity not in self._known for identity in frame.ids.tolist()], bool)
        if not newborn.any():
            return None
        ids, objects = frame.ids[newborn], frame.objects[newborn]
        self._known.update(ids.tolist())
        names = {str(n): self._names[n] for n in np.unique(objects).tolist() if n in self._names}
        return TruthBatch(source=self._source, session=self._session, ids=ids, objects=objects, names=names)

    def _batch(self, frame: Frame) -> ObservationBatch:
        ended = np.concatenate([*self._ended, frame.ended])
        self._ended.clear()
        seq, self._seq = self._seq, self._seq + 1
        return ObservationBatch(
            source=self._source,
            session=self._session,
            seq=seq,
            space=self._space,
            unit=self._unit,
            dim=self._dim,
            stamp_ns=self.stamp_ns(frame.t),
            ids=frame.ids,
            positions=frame.positions.astype(np.float32),
            sigma=_sigma(frame) if self._publish_sigma else None,
            quaternions=None if frame.quaternions is None else frame.quaternions.astype(np.float32),
            ended=ended if ended.size else None,
        )


def _sigma(frame: Frame) -> float | NDArray[np.float32] | None:
    """One number where all features agree; None where there is no noise to tell of."""
    sigma = frame.sigma
    if sigma is None or not sigma.size or not (sigma > 0).all():
        return None
    return float(sigma[0]) if bool((sigma == sigma[0]).all()) else sigma.astype(np.float32)


def in_time_order(sources: Sequence[Iterable[Frame]]) -> Iterator[tuple[int, Frame]]:
    """Merge the frames of several sources by time; yields (index of the source, frame).

    Ties go to the lower index.
    """

    def tagged(index: int, frames: Iterable[Frame]) -> Iterator[tuple[float, int, Frame]]:
        return ((frame.t, index, frame) for frame in frames)

    streams = [tagged(index, frames) for index, frames in enumerate(sources)]
    for _, index, frame in heapq.merge(*streams, key=lambda item: item[:2]):
        yield index, frame
