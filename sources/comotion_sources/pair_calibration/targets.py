"""Finds the points of a chessboard, ChArUco board or single marker in an image."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError, KnownError

from ..cameras.types import Image
from ..markers.detector import DEFAULT_DICTIONARY, corners_of, find_dictionary, make_detector, outlines

Floats = NDArray[np.float64]
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
