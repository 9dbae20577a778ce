"""The base of all cameras, and what they yield."""

import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.component import Component

from ..calibration.model import Extrinsics, Intrinsics

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of a camera."""

    stamp_ns: int  # acquisition time, nanoseconds since the Unix epoch
    image: Image  # uint8 [H, W, 3] (BGR) or [H, W] (grey)
    # float32 [H, W], z in metres, registered to the image; 0 or NaN where missing. None: no depth.
    depth: NDArray[np.float32] | None = None
    # int32 [H, W], true object under each pixel, -1 unknown. None: no truth (a real camera).
    objects: NDArray[np.int32] | None = None


class Camera:
    """A stream of frames with the properties of its camera; the base of all cameras.

    Iteration yields frames and ends when the stream ends; a live camera that fails raises
    :class:`InputError`.

    Attributes
    ----------
    live
        Frames come at the rate of the device; they can neither be slowed down nor repeated.
    has_depth
        Frames have depth, although single frames may lack it.
    rate, frames
        Nominal frames per second, and their number; None: unknown.
    intrinsics, extrinsics
        Calibration that the camera reports; None: unknown. A file from the user takes precedence.
    objects
        Names of the true objects by number; empty without truth.
    counters
        Frames that were left out, by reason.
    closed
        Set when the stream is to end.
    """

    live = False
    has_depth = False
    intrinsics: Intrinsics | None = None
    extrinsics: Extrinsics | None = None
    objects: Mapping[int, str] = {}

    def __init__(self, rate: float | None = None, frames: int | None = None) -> None:
        self.rate, self.frames = rate, frames
        self.counters: dict[str, int] = {}
        self.closed = threading.Event()

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._read():
            if self.closed.is_set():
                return
            yield frame

    def _read(self) -> Iterator[Frame]:
        """Yield the frames, for a camera that is not closed meanwhile."""
        raise NotImplementedError

    def close(self) -> None:
        """End the stream and free the device; it may be called at any time and repeatedly."""
        self.closed.set()

    def attach(self, component: Component) -> None:
        """Follow the state of a scene, as a simulated camera does; called once, before the first frame."""
