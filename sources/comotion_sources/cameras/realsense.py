"""Reads an Intel RealSense camera, with depth registered to colour; needs pyrealsense2."""

import time
from collections.abc import Generator
from typing import Any

import numpy as np

from comotion_schemas.errors import InputError

from ..calibration.model import Intrinsics
from .live import PLAUSIBLE_AGE_NS, READ_TIMEOUT_MS, LiveCamera
from .types import Frame

_WIDTH, _HEIGHT, _RATE = 640, 480, 30  # px and Hz; every model of the D400 series supports them


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
        camera = _intrinsics(stream.get_intrinsics())
    except RuntimeError as error:
        raise InputError(f"{what}: {' '.join(str(error).split())}") from None
    frames = _frames(library, pipeline, scale)
    return LiveCamera(what, frames, has_depth=True, rate=float(hertz), intrinsics=camera)


def _intrinsics(sensor: Any) -> Intrinsics:
    # The colour stream has Brown-Conrady coefficients in the order of OpenCV.
    coefficients = np.array(sensor.coeffs, np.float64)
    return Intrinsics(sensor.width, sensor.height, sensor.fx, sensor.fy, sensor.ppx, sensor.ppy, coefficients)
