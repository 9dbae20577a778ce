"""Annotated images: frames and tracks -> images with coloured features and their recent paths."""

from collections import deque
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.types import UNDETERMINED

from ..cameras.types import CameraError, Image
from .tracker import Tracks

VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mkv", ".mov"})
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_TAIL = 10  # frames
_RADIUS = 4  # px
_RIM = (0, 0, 0)
# Okabe and Ito, "Color Universal Design", 2008; the same colours as comotion_clients.colours, which this
# package must not import (a test compares the two).
_HUES = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (213, 94, 0),
    (240, 228, 66),
)
_SHADES = (0.0, -0.35, 0.45)
_GREY = (120, 120, 120)

BGR = tuple[int, int, int]


def colour(hypothesis: int) -> BGR:
    """Colour of a hypothesis as (blue, green, red) in 0..255; grey for undetermined."""
    if hypothesis == UNDETERMINED:
        return _GREY
    shade = _SHADES[hypothesis // len(_HUES) % len(_SHADES)]
    red, green, blue = (
        round(value * (1 + shade)) if shade < 0 else round(value + (255 - value) * shade)
        for value in _HUES[hypothesis % len(_HUES)]
    )
    return blue, green, red


class Annotator:
    """Draws features and their recent paths into images."""

    def __init__(self) -> None:
        self._tails: dict[int, deque[tuple[int, int]]] = {}

    def draw(self, image: Image, tracks: Tracks, hypothesis: Callable[[int], int]) -> Image:
        """Return a copy of an image, uint8 [H, W, 3], with the features of this frame."""
        canvas = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
        places = np.rint(tracks.pixels).astype(int).tolist()
        tails = {}
        for feature, (x, y) in zip(tracks.ids.tolist(), places, strict=True):
            tail = self._tails.get(feature) or deque(maxlen=_TAIL)
            tail.append((x, y))
            tails[feature] = tail
            shade = colour(hypothesis(feature))
            cv2.polylines(canvas, [np.array(tail, np.int32)], False, shade, 2, cv2.LINE_AA)
            cv2.circle(canvas, (x, y), _RADIUS + 1, _RIM, -1, cv2.LINE_AA)
            cv2.circle(canvas, (x, y), _RADIUS, shade, -1, cv2.LINE_AA)
        self._tails = tails
        return np.asarray(canvas, np.uint8)


class PreviewFile:
    """Writes images to a video file, or as PNG files to a folder.

    Parameters
    ----------
    path
        Path of a video, by its suffix, or else of a folder, which is made.
    rate
        Frames per second of a video.

    Raises
    ------
    CameraError
        If the path cannot be written.
    """

    def __init__(self, path: Path, rate: float) -> None:
        self._path = path
        self._rate = rate
        self._count = 0
        self._video: cv2.VideoWriter | None = None
        self._is_video = path.suffix.lower() in VIDEO_SUFFIXES
        try:
            (path.parent if self._is_video else path).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CameraError(f"{path}: {error.strerror}") from None

    def write(self, image: NDArray[np.uint8]) -> None:
        """Append an image."""
        if self._is_video:
            self._write_video(image)
        elif not cv2.imwrite(str(self._path / f"{self._count:06d}.png"), image, _FAST_PNG):
            raise CameraError(f"{self._path}: the preview cannot be written")
        self._count += 1

    def close(self) -> None:
        """Close the video."""
        if self._video is not None:
            self._video.release()

    def _write_video(self, image: NDArray[np.uint8]) -> None:
        if self._video is None:
            height, width = image.shape[:2]
            code = cv2.VideoWriter.fourcc(*("MJPG" if self._path.suffix.lower() == ".avi" else "mp4v"))
            self._video = cv2.VideoWriter(str(self._path), code, self._rate, (width, height))
            if not self._video.isOpened():
                raise CameraError(f"{self._path}: the preview cannot be written")
        self._video.write(image)


class DelayedPreview:
    """Delays frames until the service has fused them, or a time limit has passed.

    Parameters
    ----------
    file
        Output of the annotated images.
    hypothesis
        Maps a feature id to its hypothesis.
    fused_ns
        Returns the watermark of the service; None: there is no service.
    max_delay_ns
        Longest delay of a frame behind the newest one.
    """

    def __init__(
        self,
        file: PreviewFile,
        hypothesis: Callable[[int], int],
        fused_ns: Callable[[], int | None],
        max_delay_ns: int = 1_500_000_000,
    ) -> None:
        self._file = file
        self._hypothesis = hypothesis
        self._fused_ns = fused_ns
        self._max_delay_ns = max_delay_ns
        self._annotator = Annotator()
        self._held: deque[tuple[Image, Tracks]] = deque()

    @property
    def waiting(self) -> bool:
        """Whether the newest delayed frame may still be fused."""
        return bool(self._held) and self._fused_ns() is not None and not self._is_due(self._held[-1][1])

    def add(self, image: Image, tracks: Tracks) -> None:
        """Add a frame and write the frames that are due."""
        self._held.append((image, tracks))
        newest = tracks.stamp_ns
        while self._held and (
            self._is_due(self._held[0][1]) or newest - self._held[0][1].stamp_ns > self._max_delay_ns
        ):
            self._write()

    def close(self) -> None:
        """Write the remaining frames and close the file."""
        while self._held:
            self._write()
        self._file.close()

    def _is_due(self, tracks: Tracks) -> bool:
        fused = self._fused_ns()
        return fused is None or fused >= tracks.stamp_ns

    def _write(self) -> None:
        image, tracks = self._held.popleft()
        self._file.write(self._annotator.draw(image, tracks, self._hypothesis))
