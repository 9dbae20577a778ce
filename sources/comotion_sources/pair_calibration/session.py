"""Calibrates the second of two cameras by a target that both see."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.files import ImageFiles
from ..cameras.types import Camera, Frame
from ..errors import InputError
from .solve import PairedView, RelativePose, relative_pose
from .targets import Target

_MIN_COMMON_POINTS = 4  # a pose of a flat target needs four
_VIEW_INTERVAL_NS = 300_000_000  # a target moved by hand looks different after 0.3 s


@dataclass(frozen=True, eq=False)
class PairCalibration:
    """Extrinsics of camera B, the relative pose with its errors, and the number of views used."""

    extrinsics: Extrinsics
    fit: RelativePose
    views: int


def calibrate_pair(
    frames: Iterator[tuple[Frame, Frame]],
    target: Target,
    camera_a: Intrinsics,
    camera_b: Intrinsics,
    extrinsics_a: Extrinsics | None = None,
    most_views: int = 30,
) -> PairCalibration:
    """Estimate the extrinsics of camera B from frames of both cameras.

    Parameters
    ----------
    frames
        Pairs taken at the same time, or of a target at rest.
    target
        The target that both cameras observe.
    camera_a, camera_b
        Intrinsics of the cameras.
    extrinsics_a
        Extrinsics of camera A; None: A is the origin of ``world``.
    most_views
        Stop after this number of common views.

    Raises
    ------
    InputError
        If no frame pair shows the target to both cameras, or an image size does not match.
    """
    views: list[PairedView] = []
    for frame_a, frame_b in frames:
        for name, frame, camera in (("A", frame_a, camera_a), ("B", frame_b, camera_b)):
            height, width = frame.image.shape[:2]
            if (width, height) != (camera.width, camera.height):
                raise InputError(
                    f"camera {name}: images of {width} x {height}, "
                    f"calibration for {camera.width} x {camera.height}"
                )
        views.extend(paired_views(target, frame_a, frame_b))
        if len(views) >= most_views:
            break
    fit = relative_pose(camera_a, camera_b, views)
    return PairCalibration((extrinsics_a or Extrinsics()).after(fit.b_to_a), fit, len(views))


def paired_views(target: Target, frame_a: Frame, frame_b: Frame) -> Iterator[PairedView]:
    """Find the target in both frames and yield the points that are in both."""
    found_a, found_b = target(frame_a.image), target(frame_b.image)
    for name in sorted(found_a.keys() & found_b.keys()):
        a, b = found_a[name], found_b[name]
        common = sorted(a.keys() & b.keys())
        if len(common) >= _MIN_COMMON_POINTS:
            columns = ((a[i][0] for i in common), (a[i][1] for i in common), (b[i][1] for i in common))
            yield PairedView(*(np.array(list(column)) for column in columns))


def frame_pairs(camera_a: Camera, camera_b: Camera, timeout: float) -> Iterator[tuple[Frame, Frame]]:
    """Pair the frames of two cameras: every frame of image files, else one pair each 0.3 s.

    Parameters
    ----------
    camera_a, camera_b
        The cameras.
    timeout
        Seconds after which the pairs of a live camera end.

    Raises
    ------
    InputError
        If a camera fails.
    """
    deadline = time.monotonic() + timeout
    spaced = not (isinstance(camera_a, ImageFiles) and isinstance(camera_b, ImageFiles))
    last: int | None = None
    for frame_a, frame_b in zip(camera_a, camera_b, strict=False):
        if (camera_a.live or camera_b.live) and time.monotonic() > deadline:
            return
        if spaced and last is not None and frame_a.stamp_ns - last < _VIEW_INTERVAL_NS:
            continue
        last = frame_a.stamp_ns
        yield frame_a, frame_b


def known_intrinsics(name: str, given: Intrinsics | None, camera: Camera) -> Intrinsics:
    """Return the intrinsics from the user, or else those of the camera.

    Raises
    ------
    InputError
        If there are none.
    """
    intrinsics = given or camera.intrinsics
    if intrinsics is None:
        raise InputError(f"camera {name} needs its intrinsics: --calibration-{name.lower()} FILE")
    return intrinsics
