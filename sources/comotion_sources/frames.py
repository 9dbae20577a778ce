"""Frames, and the messages of one session of a source. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.types import Unit

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


@dataclass(kw_only=True)
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

    source: str
    session: str
    space: str
    unit: Unit
    dim: int
    moving: bool = False
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
