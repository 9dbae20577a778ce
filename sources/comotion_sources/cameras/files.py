"""Recorded images: video file or folder of images -> frames, stamped with media time from 0 on."""

import logging
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np

from comotion_schemas.errors import KnownError

from ..calibration.model import Extrinsics, Intrinsics
from .types import CameraError, Frame, Image

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"})
DEFAULT_RATE = 30.0
"""Frames per second where a file states none."""
_log = logging.getLogger(__name__)


class VideoFile:
    """A video file; each iteration starts at its beginning.

    Parameters
    ----------
    path
        A file that the FFMPEG backend of OpenCV reads.

    Raises
    ------
    CameraError
        If the file is missing or is not a video.
    """

    live = False
    has_depth = False
    intrinsics: Intrinsics | None = None
    extrinsics: Extrinsics | None = None
    objects: Mapping[int, str] = {}

    def __init__(self, path: Path) -> None:
        self._path = path
        capture = self._open()
        stated = float(capture.get(cv2.CAP_PROP_FPS))
        self.rate: float | None = stated if 0 < stated <= 1000 else DEFAULT_RATE
        count = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        # What the container states; some state nothing.
        self.frames: int | None = round(count) if 0 < count < 1e9 else None
        capture.release()
        self.counters = {"unreadable": 0}
        self._closed = False

    def __iter__(self) -> Iterator[Frame]:
        capture = self._open()
        try:
            yield from self._frames(capture)
        finally:
            capture.release()

    def close(self) -> None:
        """Let an iteration end at its next frame."""
        self._closed = True

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise CameraError(f"{self._path}: not a readable video")
        return capture

    def _frames(self, capture: cv2.VideoCapture) -> Iterator[Frame]:
        expected = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        period_ns = 1e9 / (self.rate or DEFAULT_RATE)
        count, last = 0, -1
        while not self._closed:
            ok, image = capture.read()
            if not ok:
                break
            media_ns = capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6
            # Broken containers repeat time stamps although the frames differ.
            valid = math.isfinite(media_ns) and media_ns > last
            stamp = round(media_ns) if valid else last + round(period_ns)
            count, last = count + 1, stamp
            yield Frame(stamp, np.asarray(image, np.uint8))
        if not self._closed and expected > count + 1:
            self.counters["unreadable"] += int(expected) - count
            _log.warning("%s: ended after %d of %d frames", self._path, count, int(expected))


class ImageFiles:
    """Images in natural order of their names, at a fixed rate.

    If the names are times in seconds (``1305031102.175304.png``), these are the stamps.

    Parameters
    ----------
    files
        Paths of at least one image.
    rate
        Frames per second; None: the times in the names, or else 30.
    """

    live = False
    has_depth = False
    intrinsics: Intrinsics | None = None
    extrinsics: Extrinsics | None = None
    objects: Mapping[int, str] = {}

    def __init__(self, files: Iterable[Path], rate: float | None = None) -> None:
        self._files = sorted(files, key=_natural)
        self.frames: int | None = len(self._files)
        self.rate: float | None = rate or DEFAULT_RATE
        self.counters = {"unreadable": 0}
        self._closed = False
        times = [_seconds(path.stem) for path in self._files]
        self._stamps = None if rate or None in times else [stamp_ns(path.stem) for path in self._files]

    def __iter__(self) -> Iterator[Frame]:
        for number, path in enumerate(self._files):
            if self._closed:
                return
            image = read_image(path)
            if image is None:
                self.counters["unreadable"] += 1
                _log.warning("%s: not a readable image; skipped", path)
                continue
            stamp = round(number * 1e9 / (self.rate or DEFAULT_RATE))
            yield Frame(stamp if self._stamps is None else self._stamps[number], image)

    def close(self) -> None:
        """Let an iteration end at its next frame."""
        self._closed = True


def image_files(folder: Path) -> list[Path]:
    """List the images directly in a folder."""
    return [path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()]


def read_image(path: Path) -> Image | None:
    """Read an image as uint8 [H, W, 3] (BGR); None if it cannot be read."""
    # Read by NumPy: cv2.imread prints to standard error and hides the reason.
    try:
        raw = np.fromfile(path, np.uint8)
    except OSError:
        return None
    image = cv2.imdecode(raw, cv2.IMREAD_COLOR) if raw.size else None
    return None if image is None else np.asarray(image, np.uint8)


def stamp_ns(text: str) -> int:
    """Convert seconds in decimal notation to nanoseconds exactly; a float would lose digits.

    Raises
    ------
    ValueError
        If the text is not such a number.
    """
    match = re.fullmatch(r"(\d{1,10})(?:\.(\d*))?", text)
    if match is None:
        raise KnownError(f"{text!r} is not a time in seconds")
    return int(match[1]) * 1_000_000_000 + int((match[2] or "").ljust(9, "0")[:9])


def _seconds(text: str) -> float | None:
    return float(text) if re.fullmatch(r"\d+\.\d+", text) else None


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Sort key that puts img_2 before img_10."""
    chunks = re.split(r"(\d+)", path.name)
    return [(1, int(chunk), "") if chunk.isdigit() else (0, 0, chunk) for chunk in chunks]
