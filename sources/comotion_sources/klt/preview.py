"""Images with features for people: drawn in a file as soon as they are fused, or sent to who subscribes."""

import time
from collections import deque
from typing import Any, cast

import cv2
import numpy as np

from comotion_schemas import UNDETERMINED, HypothesisUpdate, Preview, encode
from comotion_schemas.transport import stream_publisher

from ..cameras.types import Frame, Image
from ..source import Received, Source
from .drawing import Annotator
from .picture_file import PictureFile
from .tracker import Tracks

_PREVIEW_EDGE = 960  # px
_JPEG_QUALITY = 80  # 0 to 100
_MOST_UPDATES = 64
"""Updates kept between two frames: 6 s at 10 Hz."""
_LONGEST_DELAY_NS = 1_500_000_000
_FLUSH_S = 2.0  # longest wait for the hypotheses of the last frames


class DelayedPreview:
    """Delays frames until the service has fused them, 1.5 s at most, and writes them annotated to a file."""

    def __init__(self, file: PictureFile, annotator: Annotator, source: Source) -> None:
        self._file, self._annotator, self._source = file, annotator, source
        self._updates = Received(source.session, source.keys.hypotheses, "hypotheses", _MOST_UPDATES)
        self._newest: HypothesisUpdate | None = None
        self._hypotheses: dict[int, int] = {}
        self._held: deque[tuple[Image, Tracks]] = deque()

    def add(self, frame: Frame, tracks: Tracks) -> None:
        """Add a frame and write the frames that are due."""
        self._poll()
        self._held.append((frame.image, tracks))
        latest_ns = tracks.stamp_ns - _LONGEST_DELAY_NS
        while self._held and (self._is_due(self._held[0][1]) or self._held[0][1].stamp_ns < latest_ns):
            self._write()

    def close(self) -> None:
        """Wait for the hypotheses of the last frames, unless a signal ends the process; complete the file."""
        end = time.monotonic() + _FLUSH_S
        while self._held and not self._is_due(self._held[-1][1]) and time.monotonic() < end:
            if self._source.stop.wait(0.02):
                break
            self._poll()
        while self._held:
            self._write()
        self._file.close()

    def _poll(self) -> None:
        """Take the newest update, and the hypothesis of each feature of the source in it."""
        for message in self._updates.messages():
            update = cast("HypothesisUpdate", message)
            if self._newest is None or update.stamp_ns >= self._newest.stamp_ns:
                self._newest = update
                self._hypotheses = update.hypotheses_of(self._source.name, self._source.session_id)

    def _is_due(self, tracks: Tracks) -> bool:
        return self._newest is None or self._newest.stamp_ns >= tracks.stamp_ns

    def _write(self) -> None:
        image, tracks = self._held.popleft()
        listed = [] if self._newest is None else self._newest.hypotheses
        picture = self._annotator.draw(
            image, tracks, lambda feature: self._hypotheses.get(feature, UNDETERMINED), listed
        )
        self._file.write(picture)


class PreviewStream:
    """Publishes images with their features while there is a subscriber; reduces large ones to 960 px.

    `source` is that of the features; it sends at most `rate` images per second.
    """

    def __init__(self, source: Source, rate: float) -> None:
        self._publisher: Any = stream_publisher(source.session, source.keys, "preview", source.name)
        self._identity: dict[str, Any] = {"source": source.name, "session": source.session_id}
        self._period, self._due = 1.0 / rate, 0.0

    def offer(self, frame: Frame, tracks: Tracks) -> None:
        """Publish a frame if one is due and there is a subscriber."""
        now = time.monotonic()
        if now < self._due or not self._publisher.matching_status.matching:
            return
        self._due = now + self._period
        image, pixels = frame.image, tracks.pixels
        whole = np.array(image.shape[1::-1])
        if (scale := _PREVIEW_EDGE / whole.max()) < 1:
            size = np.maximum(np.rint(whole * scale), 1).astype(int)
            image = np.asarray(cv2.resize(image, size.tolist(), interpolation=cv2.INTER_AREA), np.uint8)
            # Pixel centres have integer coordinates: the image starts at -0.5.
            pixels = (pixels + 0.5) * (size / whole).astype(np.float32) - 0.5
        written, encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        if not written:
            return
        preview = Preview(
            **self._identity,
            stamp_ns=tracks.stamp_ns,
            encoding="jpeg",
            image=encoded.tobytes(),
            ids=tracks.ids,
            pixels=pixels.astype(np.float32),
        )
        self._publisher.put(encode(preview))
