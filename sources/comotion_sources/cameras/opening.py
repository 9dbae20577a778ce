"""Opens a camera by the text that the user gives: device, stream, file or folder."""

import os
import re
from importlib import import_module
from pathlib import Path

import cv2

from comotion_schemas.errors import InputError

from .files import IMAGE_SUFFIXES, ImageFiles, VideoFile
from .live import open_stream, open_webcam
from .tum import TumFolder
from .types import Camera

_ERRORS_ONLY = 2  # cv2.utils.logging.LOG_LEVEL_ERROR
FORMS = "a number or /dev/videoN, a video file, a URL, a folder, realsense[:SERIAL] or workcell:SCENE/CAMERA"


def open_frames(what: str, rate: float | None = None) -> Camera:
    """Open a camera, file, stream or folder.

    Parameters
    ----------
    what
        ``0`` or ``/dev/video0``: webcam; ``rtsp://...``, ``http://...``: stream; ``realsense`` or
        ``realsense:SERIAL``; ``workcell:SCENE/CAMERA``: a camera of the simulated workcell; a folder with
        ``rgb.txt``: TUM RGB-D; another folder: its images; an image; any other file: video.
    rate
        Frames per second: requested from a device, assumed for a folder of images. None: the default
        of the device or file.

    Raises
    ------
    InputError
        If it does not exist or cannot be read.
    """
    _silence_opencv()
    if match := re.fullmatch(r"(?:/dev/video)?(\d{1,3})", what):
        return open_webcam(int(match[1]), rate)
    if re.match(r"(?i)(rtsps?|rtmps?|https?|udp|tcp)://", what):
        return open_stream(what)
    kind, _, rest = what.partition(":")
    if kind == "realsense":
        from .live import open_realsense

        return open_realsense(rest, rate)
    if kind == "workcell":
        # Imported on demand: real cameras do not need it.
        camera: Camera = import_module("comotion_sources.workcell").WorkcellCamera(rest)
        return camera
    return _open_path(what, rate)


def _silence_opencv() -> None:
    """Stop OpenCV from writing errors to standard error that are reported as exceptions."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    if "OPENCV_LOG_LEVEL" not in os.environ:
        # OpenCV 5 has moved setLogLevel into cv2.utils.logging.
        (cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging).setLogLevel(_ERRORS_ONLY)


def _open_path(what: str, rate: float | None) -> Camera:
    path = Path(what)
    if path.is_dir():
        if (path / "rgb.txt").is_file():
            return TumFolder(path)
        images = [file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES and file.is_file()]
        if not images:
            raise InputError(f"{path}: neither images nor rgb.txt in this folder")
        return ImageFiles(images, rate)
    if path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES:
        return ImageFiles([path], rate)
    if path.is_file():
        return VideoFile(path)
    raise InputError(f"{what}: no such file or folder; name {FORMS}")
