"""From the frames of one camera to the messages of one source. Pure: offline and live send the same."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.types import Unit

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import CameraError, Frame
from ..frames import AMBIGUOUS, MessageBuilder
from .tracker import Tracks


@dataclass(frozen=True)
class CameraSpace:
    """The coordinate space a camera publishes in, and what leads there.

    Attributes
    ----------
    name, unit, dim
        As in ObservationBatch.
    intrinsics
        Lift to 3-D with these; None in pixel space.
    extrinsics
        Camera to the space; None where the space is the camera's own.
    """

    name: str
    unit: Unit
    dim: int
    intrinsics: Intrinsics | None = None
    extrinsics: Extrinsics | None = None


def choose_space(
    source: str,
    *,
    has_depth: bool,
    intrinsics: Intrinsics | None,
    extrinsics: Extrinsics | None,
    name: str | None = None,
) -> CameraSpace:
    """Decide where a camera publishes.

    Without depth: pixels, in ``<source>/pixels``. With depth: metres, in the frame its extrinsics lead
    to, or else in its own, ``<source>/optical``. A `name` given by the user wins.

    Raises
    ------
    CameraError
        If there is depth but no intrinsics to lift it with.
    """
    if not has_depth:
        return CameraSpace(name or f"{source}/pixels", "px", 2)
    if intrinsics is None:
        raise CameraError("a camera with depth needs its intrinsics: --calibration FILE (or --no-depth)")
    if extrinsics is None:
        return CameraSpace(name or f"{source}/optical", "m", 3, intrinsics)
    return CameraSpace(name or extrinsics.frame, "m", 3, intrinsics, extrinsics)


class Observer:
    """Turns tracks into messages: one batch per frame, and the truth of newborn features.

    Parameters
    ----------
    space
        Where to publish.
    builder
        Builds the messages; of the same space.
    objects
        Names of the true objects by number.
    """

    def __init__(
        self, space: CameraSpace, builder: MessageBuilder, objects: Mapping[int, str] | None = None
    ) -> None:
        self._space = space
        self._builder = builder
        self._objects = dict(objects or {})

    def messages(self, tracks: Tracks, frame: Frame) -> Iterator[TruthBatch | ObservationBatch]:
        """Build the messages of a frame; features without depth in it are left out of the batch."""
        if frame.objects is not None and tracks.born.any():
            ids = tracks.ids[tracks.born]
            objects = objects_under(frame.objects, tracks.pixels[tracks.born])
            yield self._builder.truth(ids=ids, objects=objects, names=self._objects)
        ended = tracks.ended if len(tracks.ended) else None
        positions, sigma = self._states(tracks)
        shown = np.isfinite(positions).all(axis=1)
        yield self._builder.observation(
            stamp_ns=tracks.stamp_ns,
            ids=tracks.ids[shown],
            positions=positions[shown],
            sigma=sigma[shown].astype(np.float32),
            ended=ended,
        )

    def ending(self, ids: NDArray[np.uint64], stamp_ns: int) -> ObservationBatch:
        """Build the batch that ends features, as at a cut or the end."""
        nothing = np.empty((0, self._space.dim), np.float32)
        return self._builder.observation(
            stamp_ns=stamp_ns, ids=np.empty(0, np.uint64), positions=nothing, ended=ids
        )

    def _states(self, tracks: Tracks) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if tracks.points is None or tracks.sigma is None:
            return tracks.pixels.astype(np.float64), tracks.pixel_sigma
        extrinsics = self._space.extrinsics
        points = tracks.points if extrinsics is None else extrinsics.apply(tracks.points)
        return points, tracks.sigma


def objects_under(objects: NDArray[np.int32], pixels: NDArray[np.float32]) -> NDArray[np.int32]:
    """Look up the true objects int32 [N] under pixels [N, 2]; ambiguous outside of the image."""
    height, width = objects.shape
    column, row = np.rint(pixels).astype(np.int64).T
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    found = objects[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return np.where(inside, found, AMBIGUOUS).astype(np.int32)
