"""The publisher of a camera source: Status with the counters of the camera, and preview images."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import zenoh

from comotion_schemas import Preview, encode
from comotion_schemas.component import StatusFields
from comotion_schemas.transport import declare_publisher

from ..cameras.types import Image
from ..runtime import SourcePublisher
from .flow import Pixels
from .tracker import Tracks

_PREVIEW_EDGE = 960  # px
_JPEG_QUALITY = 80  # 0 to 100


class CameraPublisher(SourcePublisher):
    """A source whose Status includes the counters and faults of its camera.

    Attributes
    ----------
    fault
        One line while the camera is lost or gives no depth; else empty.
    """

    def __init__(self, name: str, counters: Callable[[], Mapping[str, int]], **options: Any) -> None:
        super().__init__(name, **options)
        self.fault = ""
        self._more = counters

    def _status(self) -> StatusFields:
        fields = super()._status()
        counters = fields.counters | dict(self._more())
        if not self.fault:
            return replace(fields, counters=counters)
        return replace(fields, counters=counters, state="degraded", message=self.fault)


class PreviewStream:
    """Publishes images with their features while there is a subscriber; reduces large images.

    Parameters
    ----------
    session, key
        An open session, and the key to publish on.
    source, source_session
        The source of the features and its session.
    rate
        Most images per second.
    """

    def __init__(
        self, session: zenoh.Session, key: str, source: str, source_session: str, rate: float
    ) -> None:
        self._publisher: Any = declare_publisher(session, key, "preview")
        self._source, self._session = source, source_session
        self._period = 1.0 / rate
        self._due = 0.0

    def offer(self, image: Image, tracks: Tracks) -> None:
        """Publish a frame if one is due and there is a subscriber."""
        now = time.monotonic()
        if now < self._due or not self._publisher.matching_status.matching:
            return
        self._due = now + self._period
        image, pixels = reduced(image, tracks.pixels)
        ok, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not ok:
            return
        preview = Preview(
            source=self._source,
            session=self._session,
            stamp_ns=tracks.stamp_ns,
            encoding="jpeg",
            image=encoded.tobytes(),
            ids=tracks.ids,
            pixels=pixels.astype(np.float32),
        )
        self._publisher.put(encode(preview))

    def close(self) -> None:
        """Undeclare the publisher."""
        self._publisher.undeclare()


def reduced(image: Image, pixels: Pixels) -> tuple[Image, Pixels]:
    """Reduce an image to at most 960 px and scale the features in it.

    Parameters
    ----------
    image
        uint8 [H, W] or [H, W, 3].
    pixels
        float32 [N, 2], features.
    """
    height, width = image.shape[:2]
    scale = _PREVIEW_EDGE / max(height, width)
    if scale >= 1:
        return image, pixels
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Pixel centres have integer coordinates: the image starts at -0.5.
    shares = np.array([size[0] / width, size[1] / height], np.float32)
    return small, (pixels + 0.5) * shares - 0.5
