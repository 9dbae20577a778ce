"""What every camera yields, whatever it is: the interface between adapters and trackers."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import zenoh
from numpy.typing import NDArray

from comotion_schemas import Keys

from ..calibration.model import Extrinsics, Intrinsics

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
    """A stream of frames and what is known about the camera that took them.

    Iterating yields the frames and ends when the stream ends; a live camera that fails meanwhile
    raises :class:`CameraError`. `close` frees the device and may be called at any time, twice too.

    Attributes
    ----------
    live
        Frames come at the device's own pace; they can neither be slowed down nor repeated.
    has_depth
        Frames come with depth, though single ones may lack it.
    rate
        Nominal frames per second, None when unknown.
    intrinsics, extrinsics
        The camera's own calibration, None when it has none; a calibration file given by the user wins.
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
    """A camera that sees the scene over the wire, such as a simulated one."""

    def attach(self, session: zenoh.Session, keys: Keys) -> None:
        """Use this session; called once, before the first frame is asked for."""


class CameraError(ValueError):
    """A camera, file or stream that cannot be opened or read; the message is one line."""
