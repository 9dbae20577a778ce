"""Calibrates the second of two cameras by a chessboard, ChArUco board or markers that both see."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError, KnownError

from .calibration.model import Extrinsics, Intrinsics
from .cameras.files import ImageFiles
from .cameras.types import Camera, Frame, Image
from .markers import DEFAULT_DICTIONARY, corners_of, find_dictionary, make_detector, outlines

Floats = NDArray[np.float64]

_MIN_COMMON_POINTS = 4  # a pose of a flat target needs four
_VIEW_INTERVAL_NS = 300_000_000  # a target moved by hand looks different after 0.3 s
# A view whose error exceeds both, and so many times that of the median view, has a point in a wrong place.
_WRONG_PX, _WRONG_FACTOR = 1.0, 3.0


TargetPoints = dict[str, dict[int, tuple[Floats, Floats]]]
"""Name of the rigid target -> number of the point -> (point [3] in the target frame in m, pixel [2])."""

_SUBPIX = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
_MIN_CORNERS = 6
"""ChArUco: fewer corners may lie nearly on a line, which leaves the pose open."""
FORMS = (
    "chessboard:9x6:0.025 (inner corners), charuco:7x5:0.03:0.022[:DICTIONARY] (squares), "
    "marker:0.05[:DICTIONARY]"
)


Target = Callable[[Image], TargetPoints]
"""Finds the visible points of a target in an image; empty if there is none."""


def parse_target(text: str) -> Target:
    """Parse a target description: kind, size in squares or corners, lengths in metres.

    Raises
    ------
    InputError
        If the text has none of the forms in :data:`FORMS`.
    """
    kind, *values = text.split(":")
    try:
        if kind == "chessboard" and len(values) == 2:
            return _chessboard(_grid(values[0]), _length(values[1]))
        if kind == "charuco" and len(values) in {3, 4}:
            return _charuco(_grid(values[0]), _length(values[1]), _length(values[2]), *values[3:])
        if kind == "marker" and len(values) in {1, 2}:
            return _markers(_length(values[0]), *values[1:])
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"target {text!r}: {error}") from None
    raise InputError(f"target {text!r} is not one of {FORMS}")


def _grid(text: str) -> tuple[int, int]:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal() and 2 <= int(columns) <= 100 and 2 <= int(rows) <= 100):
        raise KnownError(f"{text!r} is not COLUMNSxROWS")
    return int(columns), int(rows)


def _length(text: str) -> float:
    value = float(text)
    if not 0 < value < 100:
        raise KnownError(f"{text} is not a length in metres")
    return value


def _chessboard(size: tuple[int, int], square: float) -> Target:
    """A chessboard with one even and one odd number of inner corners.

    A board with two even or two odd numbers looks the same upside down. Two cameras could then number
    its corners from opposite ends, and the result would not show the error.
    """
    columns, rows = size
    if (columns + rows) % 2 == 0:
        raise InputError(
            f"a chessboard of {columns} x {rows} inner corners looks the same upside down; "
            "use one even and one odd number, or a ChArUco board"
        )
    if min(size) < 3:
        raise InputError("a chessboard needs at least 3 inner corners each way")
    y, x = np.mgrid[:rows, :columns]
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * square

    def find(image: Image) -> TargetPoints:
        """Find the inner corners; empty unless all are visible."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        detected, corners = cv2.findChessboardCorners(grey, size, flags=flags)
        if not detected:
            return {}
        pixels = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), _SUBPIX).reshape(-1, 2).astype(np.float64)
        grid = pixels.reshape(rows, columns, 2)
        first, last = (
            float(cv2.getRectSubPix(grey, (3, 3), corners.mean(axis=(0, 1)).tolist()).mean())
            for corners in (grid[:2, :2], grid[-2:, -2:])
        )
        # The square at the first corner is dark, that at the last one light.
        ordered = pixels[::-1] if first > last else pixels
        return {"board": dict(enumerate(zip(points, ordered, strict=True)))}

    return find


def _charuco(
    size: tuple[int, int], square: float, marker: float, dictionary: str = DEFAULT_DICTIONARY
) -> Target:
    if marker >= square:
        raise InputError(f"markers of {marker} m do not fit in squares of {square} m")
    board = cv2.aruco.CharucoBoard(size, square, marker, find_dictionary(dictionary))
    points = np.asarray(board.getChessboardCorners(), np.float64)
    detector = cv2.aruco.CharucoDetector(board)

    def find(image: Image) -> TargetPoints:
        """Find the corners whose markers are visible; empty with fewer than 6."""
        corners, numbers, _, _ = detector.detectBoard(image)
        if numbers is None or len(numbers) < _MIN_CORNERS:
            return {}
        pixels = np.asarray(corners, np.float64).reshape(-1, 2)
        flat = [int(n) for n in np.ravel(numbers)]
        return {"board": {n: (points[n], pixel) for n, pixel in zip(flat, pixels, strict=True)}}

    return find


def _markers(size: float, dictionary: str = DEFAULT_DICTIONARY) -> Target:
    points, detector = corners_of(size), make_detector(find_dictionary(dictionary))

    def find(image: Image) -> TargetPoints:
        """Find the markers whose number occurs once; each is a separate target."""
        return {
            f"marker {number}": dict(enumerate(zip(points, corners.astype(np.float64), strict=True)))
            for number, corners in outlines(detector, image).items()
            if corners is not None
        }

    return find


class PairedView(NamedTuple):
    """One view of a target by both cameras: points float64 [M, 3] in m, pixels [M, 2] in A and in B."""

    points: Floats
    pixels_a: Floats
    pixels_b: Floats


class PairFit(NamedTuple):
    """Pose of camera B, root mean square reprojection errors in px in A and in B, and number of views."""

    pose: Extrinsics
    error_a: float
    error_b: float
    views: int


def calibrate_pair(
    frames: Iterator[tuple[Frame, Frame]],
    target: Target,
    camera_a: Intrinsics | None,
    camera_b: Intrinsics | None,
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
        Intrinsics of the cameras; None: unknown.
    extrinsics_a
        Extrinsics of camera A; None: A is the origin of ``world``.
    most_views
        Stop after this number of common views.

    Raises
    ------
    InputError
        If no frame pair shows the target to both cameras, an image size does not match, or a camera has no
        intrinsics.
    """
    if camera_a is None or camera_b is None:
        name = "B" if camera_b is None else "A"
        raise InputError(f"camera {name} needs its intrinsics: --calibration-{name.lower()} FILE")
    views: list[PairedView] = []
    for frame_a, frame_b in frames:
        for name, frame, camera in (("A", frame_a, camera_a), ("B", frame_b, camera_b)):
            height, width = frame.image.shape[:2]
            if (width, height) != (camera.width, camera.height):
                raise InputError(
                    f"camera {name}: images of {width} x {height}, "
                    f"calibration for {camera.width} x {camera.height}"
                )
        in_a, in_b = target(frame_a.image), target(frame_b.image)
        for name in sorted(in_a.keys() & in_b.keys()):
            a, b = in_a[name], in_b[name]
            common = sorted(a.keys() & b.keys())
            if len(common) >= _MIN_COMMON_POINTS:
                columns = zip(*((*a[i], b[i][1]) for i in common), strict=True)
                views.append(PairedView(*(np.array(column) for column in columns)))
        if len(views) >= most_views:
            break
    fit = relative_pose(camera_a, camera_b, views)
    return fit._replace(pose=(extrinsics_a or Extrinsics()).after(fit.pose))


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

    The pairs of a live camera end after `timeout` s.

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
