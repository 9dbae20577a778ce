"""What a camera source adds to the presence of a source: its counters and its troubles."""

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

_PREVIEW_EDGE = 960
_JPEG_QUALITY = 80


class CameraPublisher(SourcePublisher):
    """A source whose Status also tells what happened to its camera.

    Attributes
    ----------
    trouble
        One line while the camera is lost or gives no depth; empty when all is well.
    """

    def __init__(self, name: str, counters: Callable[[], Mapping[str, int]], **options: Any) -> None:
        super().__init__(name, **options)
        self.trouble = ""
        self._more = counters

    def _status(self) -> StatusFields:
        fields = super()._status()
        counters = fields.counters | dict(self._more())
        if not self.trouble:
            return replace(fields, counters=counters)
        return replace(fields, counters=counters, state="degraded", message=self.trouble)


class PreviewStream:
    """Publishes images with their features while somebody subscribes; a large one is made smaller.

    Parameters
    ----------
    session, key
        An open session, and where to publish.
    source, source_session
        Whose features these are.
    rate
        Most images a second.
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
    """Make an image no longer than 960 px, and move the features [N, 2] in it along."""
    height, width = image.shape[:2]
    scale = _PREVIEW_EDGE / max(height, width)
    if scale >= 1:
        return image, pixels
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    # A pixel's middle is at whole numbers: the image begins at -0.5.
    shares = np.array([size[0] / width, size[1] / height], np.float32)
    return small, (pixels + 0.5) * shares - 0.5
