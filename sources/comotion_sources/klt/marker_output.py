"""Publishes the markers in a camera's images as a separate, metric source."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Unpack

import numpy as np

from comotion_schemas.component import Where
from comotion_schemas.errors import InputError

from ..calibration.model import Extrinsics, Intrinsics
from ..cameras.types import Frame
from ..markers.detector import MarkerDetector, MarkerOptions
from ..runtime import SourcePublisher
from .tracker import Tracks


def publish_markers(
    stack: ExitStack,
    name: str,
    markers: MarkerOptions,
    intrinsics: Intrinsics | None,
    extrinsics: Extrinsics,
    *,
    rate: float,
    **where: Unpack[Where],
) -> Callable[[Frame, Tracks], None]:
    """Return what publishes the poses of the markers in a frame; an empty batch if there are none.

    The empty batch keeps the watermark of the scene moving. Poses are in the target frame of the extrinsics
    of the camera. The source is open as long as the stack.

    Raises
    ------
    InputError
        If there are no intrinsics.
    """
    if intrinsics is None:
        raise InputError("markers need the camera's intrinsics: --calibration FILE")
    detector = MarkerDetector(markers, intrinsics)
    text = f"{markers.dictionary} markers of {markers.size:g} m"
    source = stack.enter_context(
        SourcePublisher(name, space=extrinsics.frame, unit="m", dim=3, rate=rate, message=text, **where)
    )

    def publish(frame: Frame, _tracks: Tracks) -> None:
        detected = detector.detect(frame.image)
        seen = {number: pose for number, pose in detected.items() if pose is not None}
        poses = [extrinsics.after(pose) for pose, _ in seen.values()]
        source.count("refused", len(detected) - len(seen))
        source.name_features({number: f"marker {number}" for number in seen})
        source.observe(
            stamp_ns=frame.stamp_ns,
            ids=np.array(list(seen), np.uint64),
            positions=np.array([pose.translation for pose in poses]).reshape(-1, 3),
            quaternions=[pose.quaternion for pose in poses] or None,
            sigma=[sigma for _, sigma in seen.values()] or None,
        )

    return publish
