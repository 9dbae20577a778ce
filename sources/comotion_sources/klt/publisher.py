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
from .tracker import Tracks

_PREVIEW_PERIOD_S = 0.2
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
    """Publishes images with their features while somebody watches, a few a second."""

    def __init__(self, session: zenoh.Session, key: str, source: str, source_session: str) -> None:
        self._publisher: Any = declare_publisher(session, key, "preview")
        self._source, self._session = source, source_session
        self._due = 0.0

    def offer(self, image: Image, tracks: Tracks) -> None:
        """Publish a frame if one is due and there is a subscriber."""
        now = time.monotonic()
        if now < self._due or not self._publisher.matching_status.matching:
            return
        self._due = now + _PREVIEW_PERIOD_S
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
            pixels=tracks.pixels.astype(np.float32),
        )
        self._publisher.put(encode(preview))

    def close(self) -> None:
        """Undeclare the publisher."""
        self._publisher.undeclare()
