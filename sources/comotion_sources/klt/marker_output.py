"""Publishes the markers in a camera's images as a separate, metric source."""

from typing import Unpack

import numpy as np

from comotion_schemas.component import Where
from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Frame
from ..markers.detector import MarkerDetector, MarkerOptions
from ..runtime import SourcePublisher
from .tracker import Tracks


class MarkerOutput:
    """Detects markers and publishes their poses, in the target frame of the extrinsics of the camera.

    Raises
    ------
    InputError
        If there are no intrinsics.
    """

    def __init__(
        self,
        name: str,
        markers: MarkerOptions,
        intrinsics: Intrinsics | None,
        extrinsics: Extrinsics,
        *,
        rate: float,
        **where: Unpack[Where],
    ) -> None:
        if intrinsics is None:
            raise InputError("markers need the camera's intrinsics: --calibration FILE")
        self._detector = MarkerDetector(markers, intrinsics)
        self._extrinsics = extrinsics
        self.source = SourcePublisher(
            name,
            space=extrinsics.frame,
            unit="m",
            dim=3,
            rate=rate,
            message=f"{markers.dictionary} markers of {markers.size:g} m",
            **where,
        )

    def publish(self, frame: Frame, _tracks: Tracks) -> None:
        """Publish the poses of the markers in a frame; an empty batch if there are none.

        The empty batch keeps the watermark of the scene moving.
        """
        markers = self._detector.detect(frame.image)
        seen = {number: pose for number, pose in markers.items() if pose is not None}
        poses = [self._extrinsics.after(pose) for pose, _ in seen.values()]
        self.source.count("refused", len(markers) - len(seen))
        self.source.name_features({number: f"marker {number}" for number in seen})
        self.source.observe(
            stamp_ns=frame.stamp_ns,
            ids=np.array(list(seen), np.uint64),
            positions=np.array([pose.translation for pose in poses]).reshape(-1, 3),
            quaternions=[pose.quaternion for pose in poses] or None,
            sigma=[sigma for _, sigma in seen.values()] or None,
        )
