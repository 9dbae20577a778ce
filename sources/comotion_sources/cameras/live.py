"""Reads devices and network streams in a thread, so that the newest frame is there and no older one waits."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import cv2
import numpy as np

from ..calibration.model import Intrinsics
from ..errors import InputError
from .types import Camera, Frame

READ_TIMEOUT_MS = 5_000
"""How long a driver may wait for a frame or a connection."""
PLAUSIBLE_AGE_NS = 2_000_000_000
"""A stamp that makes a frame older than this at its arrival is from another clock."""
_SILENCE_S = 10.0  # without a frame for this long a camera counts as lost
_JOIN_S = 2 * READ_TIMEOUT_MS / 1000


class Device(Protocol):
    """Interface of a driver; one thread calls both methods."""

    def read(self) -> Frame | None:
        """Wait for the next frame; None when the device has ended."""

    def close(self) -> None:
        """Free the device."""


class LiveCamera(Camera):
    """Reads a device in a thread and yields the newest frame; counts the frames it drops.

    Parameters
    ----------
    what
        The camera as the user named it, for messages.
    device
        The opened device.
    has_depth, rate, intrinsics
        Properties that the device reports.
    """

    live = True

    def __init__(
        self,
        what: str,
        device: Device,
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
        self._newest: Frame | None = None
        self._closed = False
        self._lost: str | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[Frame]:
        while (frame := self._next()) is not None:
            yield frame

    def close(self) -> None:
        """Stop reading, free the device, and end an iteration that waits for a frame."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(_JOIN_S)

    def _next(self) -> Frame | None:
        with self._changed:
            changed = self._changed.wait_for(lambda: self._newest or self._closed or self._lost, _SILENCE_S)
            if self._closed:
                return None
            if self._newest is not None:
                frame, self._newest = self._newest, None
                return frame
            if not changed:
                raise InputError(f"{self._what}: no frame for {_SILENCE_S:g} s")
            raise InputError(f"{self._what}: {self._lost}")

    def _read(self) -> None:
        lost = "the camera stopped delivering frames"
        try:
            while not self._closed and (frame := self._device.read()) is not None:
                self._offer(frame)
        except Exception as error:  # drivers raise many types; the iterating thread reports all of them
            lost = " ".join(str(error).split())[:300] or type(error).__name__
        finally:
            # Free it in this thread: OpenCV crashes if another thread reads the capture meanwhile.
            self._device.close()
        with self._changed:
            self._lost = lost
            self._changed.notify_all()

    def _offer(self, frame: Frame) -> None:
        with self._changed:
            self.counters["skipped"] += self._newest is not None
            self._newest = frame
            self._changed.notify_all()


class CaptureDevice:
    """Adapts an OpenCV capture to :class:`Device`."""

    def __init__(self, capture: Any, clock: Callable[[], int] = time.time_ns) -> None:
        self._capture = capture
        self._clock = clock
        # Video4Linux stamps its buffers with the monotonic clock; other backends give no time.
        self._stamped = str(capture.getBackendName()) == "V4L2"

    def read(self) -> Frame | None:
        """Wait for the next frame; its stamp is that of the device, or else the time of the grab."""
        if not self._capture.grab():
            return None
        stamp = self._stamp_ns()
        ok, image = self._capture.retrieve()
        return Frame(stamp, np.asarray(image, np.uint8)) if ok and image is not None else None

    def close(self) -> None:
        """Free the device."""
        self._capture.release()

    def _stamp_ns(self) -> int:
        now = self._clock()
        if not self._stamped:
            return now
        age = time.monotonic_ns() - round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        # Some drivers use another clock; the time of the grab is then closer to the truth.
        return now - age if 0 <= age < PLAUSIBLE_AGE_NS else now


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
    return LiveCamera(f"camera {index}", CaptureDevice(capture), rate=_rate(capture))


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
    return LiveCamera(_without_password(url), CaptureDevice(capture), rate=_rate(capture))


def _rate(capture: Any) -> float | None:
    rate = float(capture.get(cv2.CAP_PROP_FPS))
    return rate if 0 < rate <= 1000 else None


def _without_password(url: str) -> str:
    """Remove user and password from a URL; they must not be logged."""
    scheme, _, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}"
