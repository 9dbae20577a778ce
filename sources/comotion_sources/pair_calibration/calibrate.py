"""Calibrates the second of two cameras by a target that both see."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.files import ImageFiles
from ..cameras.types import Camera, Frame
from .targets import Target

Floats = NDArray[np.float64]

_MIN_COMMON_POINTS = 4  # a pose of a flat target needs four
_VIEW_INTERVAL_NS = 300_000_000  # a target moved by hand looks different after 0.3 s
# A view whose error exceeds both, and so many times that of the median view, has a point in a wrong place.
_WRONG_PX, _WRONG_FACTOR = 1.0, 3.0


class PairedView(NamedTuple):
    """One view of a target by both cameras: points float64 [M, 3] in m, pixels [M, 2] in A and in B."""

    points: Floats
    pixels_a: Floats
    pixels_b: Floats


@dataclass(frozen=True, eq=False)
class PairFit:
    """Pose of camera B, root mean square reprojection errors in px in A and in B, and number of views."""

    pose: Extrinsics
    error_a: float
    error_b: float
    views: int


def calibrate_pair(
    frames: Iterator[tuple[Frame, Frame]],
    target: Target,
    camera_a: Intrinsics,
    camera_b: Intrinsics,
    extrinsics_a: Extrinsics | None = None,
    most_views: int = 30,
) -> PairFit:
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
        views.extend(_paired_views(target, frame_a, frame_b))
        if len(views) >= most_views:
            break
    fit = relative_pose(camera_a, camera_b, views)
    return replace(fit, pose=(extrinsics_a or Extrinsics()).after(fit.pose))


def _paired_views(target: Target, frame_a: Frame, frame_b: Frame) -> Iterator[PairedView]:
    """Find the target in both frames and yield the points that are in both."""
    seen_a, seen_b = target(frame_a.image), target(frame_b.image)
    for name in sorted(seen_a.keys() & seen_b.keys()):
        a, b = seen_a[name], seen_b[name]
        common = sorted(a.keys() & b.keys())
        if len(common) >= _MIN_COMMON_POINTS:
            columns = zip(*((*a[i], b[i][1]) for i in common), strict=True)
            yield PairedView(*(np.array(column) for column in columns))


def relative_pose(camera_a: Intrinsics, camera_b: Intrinsics, views: Sequence[PairedView]) -> PairFit:
    """Estimate the pose of camera B in the frame of camera A.

    Least squares over the reprojection errors in both images, by OpenCV's ``stereoCalibrate``; then once more
    without the views that fit far worse than most.

    Parameters
    ----------
    camera_a, camera_b
        Intrinsics.
    views
        Common views of the target.

    Raises
    ------
    InputError
        If there is no view, or no pose fits.
    """
    if not views:
        raise InputError("the target was never seen by both cameras")
    fit: Any = cv2.stereoCalibrateExtended
    lenses = [part for camera in (camera_a, camera_b) for part in (camera.matrix, camera.distortion)]
    size, start, fitting = (camera_a.width, camera_a.height), (np.eye(3), np.zeros(3)), list(views)
    for _ in range(2):
        images = (list(map(np.float32, parts)) for parts in zip(*fitting, strict=True))
        try:
            *_, turn, shift, _, _, _, _, errors = fit(
                *images, *lenses, size, *start, flags=cv2.CALIB_FIX_INTRINSIC
            )
        except cv2.error:
            raise InputError("no pose fits the images of the target; is its size right?") from None
        worst = errors.max(axis=1)
        limit = max(_WRONG_PX, _WRONG_FACTOR * float(np.median(worst)))
        fitting = [view for view, error in zip(fitting, worst, strict=True) if error <= limit]
    error_a, error_b = np.sqrt((errors**2).mean(axis=0)).tolist()
    return PairFit(Extrinsics(turn, shift.ravel()).inverse(), error_a, error_b, len(views))


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
