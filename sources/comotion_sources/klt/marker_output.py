"""The markers a camera sees, as a source of their own: metric where its features may not be."""

from typing import Any

import numpy as np

from ..calibration.files import CalibrationError
from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Frame
from ..markers.detector import MarkerDetector, MarkerOptions
from .publisher import CameraPublisher


class MarkerOutput:
    """Detects markers and publishes their poses.

    Parameters
    ----------
    name
        Name of the source.
    markers
        Which markers.
    intrinsics, extrinsics
        Of the camera; the extrinsics say in which space the poses are.
    presence
        What else :class:`CameraPublisher` takes.

    Raises
    ------
    CalibrationError
        If there are no intrinsics.
    """

    def __init__(
        self,
        name: str,
        markers: MarkerOptions,
        intrinsics: Intrinsics | None,
        extrinsics: Extrinsics,
        **presence: Any,
    ) -> None:
        if intrinsics is None:
            raise CalibrationError("markers need the camera's intrinsics: --calibration FILE")
        self._detector = MarkerDetector(markers, intrinsics)
        self._extrinsics = extrinsics
        self._counters = {"refused": 0}
        self.publisher = CameraPublisher(
            name,
            lambda: self._counters,
            space=extrinsics.frame,
            unit="m",
            dim=3,
            message=f"{markers.dictionary} markers of {markers.size:g} m",
            **presence,
        )

    def publish(self, frame: Frame) -> None:
        """Publish the poses of the markers in a frame; a frame without any says that time goes on."""
        markers = self._detector.detect(frame.image)
        self._counters["refused"] += markers.refused
        poses = [self._extrinsics.after(pose) for pose in markers.poses]
        count = len(poses)
        self.publisher.observe(
            stamp_ns=frame.stamp_ns,
            ids=markers.numbers,
            positions=np.array([pose.translation for pose in poses]).reshape(count, 3),
            quaternions=np.array([pose.quaternion for pose in poses]).reshape(count, 4) if count else None,
            sigma=markers.sigma if count else None,
        )
