"""Reads video files and folders of images, stamped with media time from 0 on."""

import logging
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

from ..poses import stamp_ns
from .types import Camera, Frame, Image

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"})
DEFAULT_RATE = 30.0
"""Frames per second where a file states none."""
_log = logging.getLogger(__name__)


class RecordedCamera(Camera):
    """What cameras have in common that are recorded: they can be read again."""

    def __init__(self, rate: float | None, frames: int | None) -> None:
        super().__init__(rate, frames)
        self.counters["unreadable"] = 0

    def _images(self, files: Iterable[Path]) -> Iterator[tuple[int, Path, Image]]:
        """Yield number, path and image of all files that can be read."""
        for number, path in enumerate(files):
            image = read_image(path)
            if image is None:
                self.counters["unreadable"] += 1
                _log.warning("%s: not a readable image; skipped", path)
            else:
                yield number, path, image


class VideoFile(RecordedCamera):
    """A video file; each iteration starts at its beginning.

    `path` is a file that the FFMPEG backend of OpenCV reads.

    Raises
    ------
    InputError
        If the file is missing or is not a video.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        capture = self._open()
        stated = float(capture.get(cv2.CAP_PROP_FPS))
        count = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.release()
        super().__init__(
            stated if 0 < stated <= 1000 else DEFAULT_RATE,
            # What the container states; some state nothing.
            round(count) if 0 < count < 1e9 else None,
        )

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise InputError(f"{self._path}: not a readable video")
        return capture

    def _read(self) -> Iterator[Frame]:
        capture = self._open()
        expected = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        period_ns = 1e9 / (self.rate or DEFAULT_RATE)
        count, last = 0, -1
        while (read := capture.read())[0]:
            media_ns = capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6
            # Broken containers repeat time stamps although the frames differ.
            valid = math.isfinite(media_ns) and media_ns > last
            stamp = round(media_ns) if valid else last + round(period_ns)
            count, last = count + 1, stamp
            yield Frame(stamp, np.asarray(read[1], np.uint8))
        # Where a container states a duration alone, and frames come unevenly, their number is an estimate.
        if expected > count + 1 and last < expected * period_ns - 0.25e9:
            self.counters["unreadable"] += int(expected) - count
            _log.warning("%s: ended after %d of %d frames", self._path, count, int(expected))


class ImageFiles(RecordedCamera):
    """Images in natural order of their names, at a fixed rate.

    If the names are times in seconds (``1305031102.175304.png``), these are the stamps.

    There is at least one of the `files`; `rate` is in frames per second, None: the times in the names, or
    else 30.
    """

    def __init__(self, files: Iterable[Path], rate: float | None = None) -> None:
        # Natural order puts img_2 before img_10.
        self._files = sorted(
            files, key=lambda path: [(c.isdecimal() and int(c), c) for c in re.split(r"(\d+)", path.name)]
        )
        super().__init__(rate or DEFAULT_RATE, len(self._files))
        timed = not rate and all(re.fullmatch(r"\d+\.\d+", path.stem) for path in self._files)
        self._stamps = [stamp_ns(path.stem) for path in self._files] if timed else None

    def _read(self) -> Iterator[Frame]:
        for number, _, image in self._images(self._files):
            stamp = round(number * 1e9 / (self.rate or DEFAULT_RATE))
            yield Frame(stamp if self._stamps is None else self._stamps[number], image)


def read_image(path: Path, flags: int = cv2.IMREAD_COLOR) -> NDArray[Any] | None:
    """Read an image, by default as uint8 [H, W, 3] (BGR); None if it cannot be read."""
    # Read by NumPy: cv2.imread prints to standard error and hides the reason.
    try:
        raw = np.fromfile(path, np.uint8)
    except OSError:
        return None
    return cv2.imdecode(raw, flags) if raw.size else None
