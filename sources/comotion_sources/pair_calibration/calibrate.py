"""Calibrates the second of two cameras by a target that both see."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics, Intrinsics, planar_poses, reprojection, rms
from ..cameras.files import ImageFiles
from ..cameras.types import Camera, Frame
from .targets import Target

Floats = NDArray[np.float64]

_MIN_COMMON_POINTS = 4  # a pose of a flat target needs four
_VIEW_INTERVAL_NS = 300_000_000  # a target moved by hand looks different after 0.3 s
_ROBUST_PX = 1.0  # soft L1: larger reprojection errors count linearly
_MAX_CANDIDATES = 60  # start values that are scored: 15 views with two poses in each image


@dataclass(frozen=True, eq=False)
class PairedView:
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

    Each view alone gives candidates for the pose: a flat target fits two poses in each image. The candidate
    with the least median error over all views is refined, together with the pose of the target in each view,
    by least squares over the reprojection errors in both images (robust: soft L1 beyond 1 px).

    Parameters
    ----------
    camera_a, camera_b
        Intrinsics.
    views
        Common views of the target.

    Raises
    ------
    InputError
        If there is no view, or no view gives a pose.
    """

    def errors(b_to_a: Extrinsics, target: Extrinsics, view: PairedView) -> Floats:
        """Reprojection errors [2, M, 2] in A and B of a target, by its pose in A."""
        in_b = reprojection(camera_b, b_to_a.inverse().after(target), view.points, view.pixels_b)
        return np.stack([reprojection(camera_a, target, view.points, view.pixels_a), in_b])

    def fits(b_to_a: Extrinsics) -> list[tuple[float, Extrinsics]]:
        """Of each view the pose of the target in A that fits both images best, with its error."""
        scored = [[(rms(errors(b_to_a, pose, view)), pose) for _, pose in poses] for view, poses, _ in used]
        return [min(poses, key=lambda fit: fit[0]) for poses in scored]

    if not views:
        raise InputError("the target was never seen by both cameras")
    posed = [
        (
            view,
            planar_poses(camera_a, view.points, view.pixels_a),
            planar_poses(camera_b, view.points, view.pixels_b),
        )
        for view in views
    ]
    used = [view for view in posed if view[1]]
    candidates = [a.after(b.inverse()) for _, in_a, in_b in used for _, a in in_a for _, b in in_b]
    if not candidates:
        raise InputError("no pose fits the images of the target; is its size right?")
    chosen = candidates[:: max(1, len(candidates) // _MAX_CANDIDATES)]
    start = min(chosen, key=lambda candidate: np.median([error for error, _ in fits(candidate)]))

    def residuals(values: Floats) -> list[Floats]:
        b_to_a, *targets = (Extrinsics.from_vector(vector) for vector in values.reshape(-1, 6))
        return [errors(b_to_a, target, view) for target, (view, _, _) in zip(targets, used, strict=True)]

    solution = least_squares(
        lambda values: np.concatenate([part.ravel() for part in residuals(values)]),
        np.concatenate([start.vector, *(target.vector for _, target in fits(start))]),
        loss="soft_l1",
        f_scale=_ROBUST_PX,
    )
    error_a, error_b = map(rms, np.concatenate(residuals(solution.x), axis=1))
    return PairFit(Extrinsics.from_vector(solution.x[:6]), error_a, error_b, len(views))


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
