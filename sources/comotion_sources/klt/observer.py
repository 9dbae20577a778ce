"""Makes the messages of a camera's tracks. Pure: a live process and offline runs send the same."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.errors import InputError
from comotion_schemas.types import Unit

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Frame
from ..poses import PoseBuffer
from ..streams import AMBIGUOUS, MessageBuilder
from .tracker import Tracks


@dataclass(frozen=True)
class CameraSpace:
    """The coordinate space that a camera publishes in, and the transformation to it."""

    # As in ObservationBatch.
    name: str
    unit: Unit
    dim: int
    intrinsics: Intrinsics | None = None  # used to lift pixels to 3-D; None in pixel space
    extrinsics: Extrinsics | None = None  # camera to the space; None if the space is the frame of the camera

    def builder(self, source: str, session: str, *, moving: bool = False) -> MessageBuilder:
        """Build the messages of one session of a source in this space."""
        return MessageBuilder(
            source=source, session=session, space=self.name, unit=self.unit, dim=self.dim, moving=moving
        )


def choose_space(
    source: str,
    *,
    has_depth: bool,
    intrinsics: Intrinsics | None,
    extrinsics: Extrinsics | None,
    name: str | None = None,
) -> CameraSpace:
    """Choose the coordinate space that a camera publishes in.

    Without depth: pixels, in ``<source>/pixels``. With depth: metres, in the target frame of the
    extrinsics, or without extrinsics in the camera frame ``<source>/optical``.

    `intrinsics` and `extrinsics` are those of the camera, if known; `name` is that of the space, None: as
    above.

    Raises
    ------
    InputError
        If there is depth but no intrinsics.
    """
    if not has_depth:
        return CameraSpace(name or f"{source}/pixels", "px", 2)
    if intrinsics is None:
        raise InputError("a camera with depth needs its intrinsics: --calibration FILE (or --no-depth)")
    if extrinsics is None:
        return CameraSpace(name or f"{source}/optical", "m", 3, intrinsics)
    return CameraSpace(name or extrinsics.frame, "m", 3, intrinsics, extrinsics)


class Observer:
    """Builds one batch per frame from tracks, and the truth of newborn features.

    The `builder` is of the same space; `objects` are names of the true objects by number; `poses` those of a
    carried camera over time, in the space, None: the camera is fixed, or its pose unknown.

    Attributes
    ----------
    unposed
        Number of frames that were left out because their pose was not known.
    """

    def __init__(
        self,
        space: CameraSpace,
        builder: MessageBuilder,
        objects: Mapping[int, str] | None = None,
        poses: PoseBuffer | None = None,
    ) -> None:
        self._space, self._builder, self._objects = space, builder, dict(objects or {})
        self._poses, self.unposed = poses, 0

    def messages(self, tracks: Tracks, frame: Frame) -> Iterator[TruthBatch | ObservationBatch]:
        """Build the messages of a frame; its batch leaves out features without depth."""
        if frame.objects is not None and tracks.born.any():
            ids = tracks.ids[tracks.born]
            height, width = frame.objects.shape
            column, row = np.rint(tracks.pixels[tracks.born]).astype(np.int64).T
            inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            nearest = frame.objects[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
            objects = np.where(inside, nearest, AMBIGUOUS)
            yield self._builder.truth(ids=ids, objects=objects, names=self._objects)
        positions = self._positions(tracks)
        shown = np.isfinite(positions).all(axis=1)
        sigma = tracks.sigma[shown].astype(np.float32)
        yield self._builder.observation(
            stamp_ns=tracks.stamp_ns,
            ids=tracks.ids[shown],
            positions=positions[shown],
            sigma=sigma if np.isfinite(sigma).all() else None,
            ended=tracks.ended if len(tracks.ended) else None,
        )

    def ending(self, ids: NDArray[np.uint64], stamp_ns: int) -> ObservationBatch:
        """Build the batch that ends features, as after a cut or at the end of the stream."""
        nothing = np.empty((0, self._space.dim))
        return self._builder.observation(stamp_ns=stamp_ns, ids=[], positions=nothing, ended=ids)

    def _positions(self, tracks: Tracks) -> NDArray[np.float64]:
        extrinsics = self._space.extrinsics
        if self._poses is not None:
            extrinsics = self._poses.at(tracks.stamp_ns)
            if extrinsics is None:
                self.unposed += 1
                return np.full_like(tracks.positions, np.nan)
        return tracks.positions if extrinsics is None else extrinsics.apply(tracks.positions)
