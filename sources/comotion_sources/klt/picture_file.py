"""Writes images to a video file, H.264 where there is an encoder, or as PNG files to a folder."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np

from comotion_schemas.errors import InputError

from ..cameras.types import Image

_Writer: TypeAlias = tuple[Callable[[Image], object], Callable[[], object]]
"""Appends an image; completes the file."""
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mkv", ".mov"})
_FAST_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_QUALITY = "23"  # constant rate factor of x264: lower is better and larger
NO_ENCODER = "not H.264, which browsers need: pip install 'comotion[video]'"


def frames_in(path: Path) -> list[Path]:
    """Images in a folder that an earlier run has written there; none for a video."""
    if path.suffix.lower() in VIDEO_SUFFIXES or not path.is_dir():
        return []
    return sorted(path.glob("[0-9]" * 6 + ".png"))


class PictureFile:
    """Writes images to a video file, or as PNG files to a folder.

    Parameters
    ----------
    path
        Path of a video, by its suffix, or else of a folder, which is made.
    rate
        Frames per second of a video.

    Attributes
    ----------
    codec
        ``h264``, ``mpeg4``, ``mjpeg`` or ``png``.

    Raises
    ------
    InputError
        If the path cannot be written.
    """

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self._rate, self._count = path, rate, 0
        self._writer: _Writer | None = None
        self._is_video = path.suffix.lower() in VIDEO_SUFFIXES
        self.codec = _codec(path) if self._is_video else "png"
        try:
            (path.parent if self._is_video else path).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}") from None

    def write(self, image: Image) -> None:
        """Append an image, uint8 [H, W, 3] (BGR)."""
        if self._is_video:
            if self._writer is None:
                opened = _av if self.codec == "h264" else _opencv
                self._writer = opened(self._path, self._rate, image.shape[:2])
            self._writer[0](image)
        elif not cv2.imwrite(str(self._path / f"{self._count:06d}.png"), image, _FAST_PNG):
            raise InputError(f"{self._path}: the picture cannot be written")
        self._count += 1

    def close(self) -> None:
        """Complete the video."""
        if self._writer is not None:
            self._writer[1]()
            self._writer = None


def _codec(path: Path) -> str:
    if path.suffix.lower() == ".avi":
        return "mjpeg"
    try:
        import av
    except ModuleNotFoundError:
        return "mpeg4"
    return "h264" if "libx264" in av.codecs_available else "mpeg4"


def _av(path: Path, rate: float, shape: tuple[int, ...]) -> _Writer:
    """H.264 by PyAV."""
    import av

    try:
        container = av.open(str(path), "w")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or 'cannot be written'}") from None
    exact = Fraction(rate).limit_denominator(1001)  # 30000/1001 of television too
    stream: Any = container.add_stream("libx264", rate=exact)
    # Chroma has half the resolution, so both sides are even.
    stream.height, stream.width = (size + size % 2 for size in shape)
    stream.pix_fmt = "yuv420p"
    stream.options = {"crf": _QUALITY, "preset": "veryfast"}

    def write(image: Image) -> None:
        below, right = stream.height - image.shape[0], stream.width - image.shape[1]
        padded = np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), np.uint8)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(padded, format="bgr24")))

    def close() -> None:
        container.mux(stream.encode())
        container.close()

    return write, close


def _opencv(path: Path, rate: float, shape: tuple[int, ...]) -> _Writer:
    """MPEG-4 or Motion JPEG by OpenCV."""
    code = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix.lower() == ".avi" else "mp4v"))
    video = cv2.VideoWriter(str(path), code, rate, (shape[1], shape[0]))
    if not video.isOpened():
        raise InputError(f"{path}: the video cannot be written")
    return video.write, video.release
