"""The camera interface: what camera adapters yield and trackers use."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import zenoh
from numpy.typing import NDArray

from comotion_schemas import Keys

from ..calibration.model import Extrinsics, Intrinsics
from ..errors import InputError

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image of a camera.

    Attributes
    ----------
    stamp_ns
        Acquisition time, nanoseconds since the Unix epoch.
    image
        uint8 [H, W, 3] (BGR) or [H, W] (grey).
    depth
        float32 [H, W], z in metres, registered to the image; 0 or NaN where missing. None: no depth.
    objects
        int32 [H, W], true object under each pixel, -1 unknown. None: no truth (a real camera).
    """

    stamp_ns: int
    image: Image
    depth: NDArray[np.float32] | None = None
    objects: NDArray[np.int32] | None = None


@runtime_checkable
class Camera(Protocol):
    """A stream of frames with the properties of its camera.

    Iteration yields frames and ends when the stream ends; a live camera that fails raises
    :class:`InputError`. `close` frees the device; it may be called at any time and repeatedly.

    Attributes
    ----------
    live
        Frames come at the rate of the device; they can neither be slowed down nor repeated.
    has_depth
        Frames have depth, although single frames may lack it.
    rate
        Nominal frames per second; None: unknown.
    intrinsics, extrinsics
        Calibration that the camera reports; None: unknown. A file from the user takes precedence.
    objects
        Names of the true objects by number; empty without truth.
    """

    live: bool
    has_depth: bool
    rate: float | None
    intrinsics: Intrinsics | None
    extrinsics: Extrinsics | None
    objects: Mapping[int, str]

    def __iter__(self) -> Iterator[Frame]: ...

    def close(self) -> None:
        """Free the device."""


@runtime_checkable
class SceneCamera(Camera, Protocol):
    """A camera that receives the state of the scene over Zenoh, such as a simulated camera."""

    def attach(self, session: zenoh.Session, keys: Keys) -> None:
        """Use this session; called once, before the first frame is read."""


CameraError = InputError
"""The error of a camera, file or stream that cannot be opened or read."""
