"""Reads devices and network streams in a thread, so that the newest frame is there and no older one waits.

An Intel RealSense camera, with depth registered to colour, needs pyrealsense2.
"""

import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, suppress
from queue import Empty, Queue
from typing import Any

import cv2
import numpy as np

from comotion_schemas.errors import InputError

from ..calibration.model import Intrinsics
from .types import Camera, Frame

READ_TIMEOUT_MS = 5_000
"""How long a driver may wait for a frame or a connection."""
PLAUSIBLE_AGE_NS = 2_000_000_000
"""A stamp that makes a frame older than this at its arrival is from another clock."""
_SILENCE_S = 10.0  # without a frame for this long a camera counts as lost
_JOIN_S = 2 * READ_TIMEOUT_MS / 1000
_WIDTH, _HEIGHT, _RATE = 640, 480, 30  # px and Hz; every model of the D400 series supports them


class LiveCamera(Camera):
    """Reads a device in a thread and yields the newest frame; counts the frames it drops.

    `what` is the camera as the user named it, for messages. The `device` yields the frames; its thread alone
    runs it and then closes it. `has_depth`, `rate` and `intrinsics` are what the device reports.
    """

    live = True

    def __init__(
        self,
        what: str,
        device: Generator[Frame],
        *,
        has_depth: bool = False,
        rate: float | None = None,
        intrinsics: Intrinsics | None = None,
    ) -> None:
        super().__init__(rate)
        self.has_depth, self.intrinsics = has_depth, intrinsics
        self.counters["skipped"] = 0
        self._what = what
        self._device = device
        # The newest frame; at last, why there are no more.
        self._waiting = Queue[Frame | str]()
        self._thread = threading.Thread(target=self._follow, name="camera", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop reading, free the device, and end an iteration that waits for a frame."""
        super().close()
        self._waiting.put("closed")
        self._thread.join(_JOIN_S)

    def _read(self) -> Iterator[Frame]:
        while not self.closed.is_set():
            try:
                newest = self._waiting.get(timeout=_SILENCE_S)
            except Empty:
                newest = f"no frame for {_SILENCE_S:g} s"
            if isinstance(newest, Frame):
                yield newest
            elif not self.closed.is_set():
                raise InputError(f"{self._what}: {newest}")

    def _follow(self) -> None:
        lost = "the camera stopped delivering frames"
        try:
            # Free it in this thread: OpenCV crashes if another thread reads the capture meanwhile.
            with closing(self._device):
                for frame in self._device:
                    if self.closed.is_set():
                        break
                    with suppress(Empty):
                        self._waiting.get_nowait()
                        self.counters["skipped"] += 1
                    self._waiting.put(frame)
        except Exception as error:  # drivers raise many types; the iterating thread reports all of them
            lost = " ".join(str(error).split())[:300] or type(error).__name__
        self._waiting.put(lost)


def captured(capture: Any, clock: Callable[[], int] = time.time_ns) -> Generator[Frame]:
    """Yield the frames of an OpenCV capture, stamped by the device, or else at the grab."""
    # Video4Linux stamps its buffers with the monotonic clock; other backends give no time.
    stamped = str(capture.getBackendName()) == "V4L2"
    try:
        while capture.grab():
            now = clock()
            age = time.monotonic_ns() - round(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6) if stamped else 0
            ok, image = capture.retrieve()
            if not ok or image is None:
                return
            # Some drivers use another clock; the time of the grab is then closer to the truth.
            yield Frame(now - age if 0 <= age < PLAUSIBLE_AGE_NS else now, np.asarray(image, np.uint8))
    finally:
        capture.release()


def open_webcam(index: int, rate: float | None = None) -> LiveCamera:
    """Open a webcam or V4L2 device by its number.

    Raises
    ------
    InputError
        If there is no such device, or it is in use.
    """
    capture = cv2.VideoCapture(index, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise InputError(f"camera {index}: no such device, or it is in use")
    if rate:
        capture.set(cv2.CAP_PROP_FPS, rate)
    return LiveCamera(f"camera {index}", captured(capture), rate=_rate(capture))


def open_stream(url: str) -> LiveCamera:
    """Open a network stream (RTSP, RTMP, HTTP, UDP).

    Raises
    ------
    InputError
        If nothing answers at the URL, or it is not a video.
    """
    limits = [
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
        READ_TIMEOUT_MS,
        cv2.CAP_PROP_READ_TIMEOUT_MSEC,
        READ_TIMEOUT_MS,
    ]
    capture = cv2.VideoCapture(url, cv2.CAP_FFMPEG, limits)
    if not capture.isOpened():
        raise InputError(f"{_without_password(url)}: nothing answers at this URL, or it is not a video")
    return LiveCamera(_without_password(url), captured(capture), rate=_rate(capture))


def _rate(capture: Any) -> float | None:
    rate = float(capture.get(cv2.CAP_PROP_FPS))
    return rate if 0 < rate <= 1000 else None


def _without_password(url: str) -> str:
    """Remove user and password from a URL; they must not be logged."""
    scheme, _, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}"


def _frames(library: Any, pipeline: Any, depth_scale: float) -> Generator[Frame]:
    """Yield pairs of colour, and depth registered to it; the library raises when the camera is lost."""
    align, scale = library.align(library.stream.color), np.float32(depth_scale)
    domains = {library.timestamp_domain.system_time, library.timestamp_domain.global_time}
    try:
        while True:
            frames = align.process(pipeline.wait_for_frames(READ_TIMEOUT_MS))
            colour, depth = frames.get_color_frame(), frames.get_depth_frame()
            if not colour:
                return
            now, reported = time.time_ns(), round(float(colour.get_timestamp()) * 1e6)
            trusted = (
                colour.get_frame_timestamp_domain() in domains and abs(now - reported) < PLAUSIBLE_AGE_NS
            )
            z = np.asanyarray(depth.get_data()).astype(np.float32) * scale if depth else None
            yield Frame(reported if trusted else now, np.array(colour.get_data(), np.uint8), z)
    finally:
        pipeline.stop()


def open_realsense(serial: str = "", rate: float | None = None) -> LiveCamera:
    """Open the RealSense camera with a serial number, or the only camera.

    Raises
    ------
    InputError
        If pyrealsense2 is not installed, or there is no such camera.
    """
    try:
        import pyrealsense2 as library
    except ModuleNotFoundError:
        raise InputError("pyrealsense2 is not installed: pip install pyrealsense2") from None
    except ImportError as error:  # it is installed, but a library of the system is missing
        raise InputError(f"pyrealsense2 cannot be loaded: {' '.join(str(error).split())}") from None
    config, pipeline = library.config(), library.pipeline()
    if serial:
        config.enable_device(serial)
    hertz = round(rate or _RATE)
    config.enable_stream(library.stream.color, _WIDTH, _HEIGHT, library.format.bgr8, hertz)
    config.enable_stream(library.stream.depth, _WIDTH, _HEIGHT, library.format.z16, hertz)
    what = f"realsense:{serial}" if serial else "realsense"
    try:
        profile = pipeline.start(config)
        scale = profile.get_device().first_depth_sensor().get_depth_scale()
        stream = profile.get_stream(library.stream.color).as_video_stream_profile()
        sensor = stream.get_intrinsics()
        size, focal, middle = (sensor.width, sensor.height), (sensor.fx, sensor.fy), (sensor.ppx, sensor.ppy)
        # The colour stream has Brown-Conrady coefficients in the order of OpenCV.
        camera = Intrinsics(*size, *focal, *middle, np.array(sensor.coeffs, np.float64))
    except RuntimeError as error:
        raise InputError(f"{what}: {' '.join(str(error).split())}") from None
    frames = _frames(library, pipeline, scale)
    return LiveCamera(what, frames, has_depth=True, rate=float(hertz), intrinsics=camera)
