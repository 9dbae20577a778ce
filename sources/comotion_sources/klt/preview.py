"""Images with features for people: drawn in a file as soon as they are fused, or sent to who subscribes."""

import time
from collections import deque
from collections.abc import Sequence
from typing import Any, cast

import cv2
import numpy as np

from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Preview, encode
from comotion_schemas.transport import stream_publisher

from ..cameras.types import Image
from ..received import Inbox
from ..runtime import Source
from .drawing import Annotator
from .flow import Pixels
from .picture_file import PictureFile
from .tracker import Tracks

_PREVIEW_EDGE = 960  # px
_JPEG_QUALITY = 80  # 0 to 100
_MOST_UPDATES = 64
"""Updates kept between two frames: 6 s at 10 Hz."""
_LONGEST_DELAY_NS = 1_500_000_000


class HypothesisFeed:
    """The newest hypothesis of each feature of a source, from the updates of the service; never blocks.

    Attributes
    ----------
    stamp_ns
        Watermark of the newest update; None before the first.
    listed
        All hypotheses of that update.
    """

    def __init__(self, source: Source) -> None:
        component = source.component
        self._source = (source.name, component.session_id)
        self._updates = Inbox(component.session, component.keys.hypotheses, "hypotheses", _MOST_UPDATES)
        self.stamp_ns: int | None = None
        self.listed: Sequence[Hypothesis] = []
        self._hypotheses: dict[int, int] = {}
        self.close = self._updates.close

    def poll(self) -> None:
        """Process the updates that arrived since the last call."""
        for message in self._updates.messages():
            update = cast("HypothesisUpdate", message)
            if self.stamp_ns is not None and update.stamp_ns < self.stamp_ns:
                continue
            self.stamp_ns, self.listed = update.stamp_ns, update.hypotheses
            mine = [i for i, ref in enumerate(update.sources) if (ref.name, ref.session) == self._source]
            rows = np.isin(update.track_source, mine)
            pairs = zip(update.track_id[rows].tolist(), update.track_hypothesis[rows].tolist(), strict=True)
            self._hypotheses = dict(pairs)

    def hypothesis(self, feature: int) -> int:
        """Return the hypothesis of a feature; UNDETERMINED if the service has not listed it."""
        return self._hypotheses.get(feature, UNDETERMINED)


class DelayedPreview:
    """Delays frames until the service has fused them, 1.5 s at most, and writes them annotated to a file."""

    def __init__(self, file: PictureFile, annotator: Annotator, feed: HypothesisFeed) -> None:
        self._file, self._annotator, self._feed = file, annotator, feed
        self._held: deque[tuple[Image, Tracks]] = deque()

    def is_waiting(self) -> bool:
        """Whether the newest delayed frame may still be fused."""
        self._feed.poll()
        return bool(self._held) and self._feed.stamp_ns is not None and not self._is_due(self._held[-1][1])

    def add(self, image: Image, tracks: Tracks) -> None:
        """Add a frame and write the frames that are due."""
        self._feed.poll()
        self._held.append((image, tracks))
        latest_ns = tracks.stamp_ns - _LONGEST_DELAY_NS
        while self._held and (self._is_due(self._held[0][1]) or self._held[0][1].stamp_ns < latest_ns):
            self._write()

    def close(self) -> None:
        """Write the remaining frames and close the file."""
        while self._held:
            self._write()
        self._file.close()
        self._feed.close()

    def _is_due(self, tracks: Tracks) -> bool:
        fused = self._feed.stamp_ns
        return fused is None or fused >= tracks.stamp_ns

    def _write(self) -> None:
        image, tracks = self._held.popleft()
        self._file.write(self._annotator.draw(image, tracks, self._feed.hypothesis, self._feed.listed))


class PreviewStream:
    """Publishes images with their features while there is a subscriber; reduces large images.

    Parameters
    ----------
    source
        The source of the features.
    rate
        Most images per second.
    """

    def __init__(self, source: Source, rate: float) -> None:
        component = source.component
        self._publisher: Any = stream_publisher(component.session, component.keys, "preview", source.name)
        self._identity: dict[str, Any] = {"source": source.name, "session": component.session_id}
        self._period, self._due = 1.0 / rate, 0.0
        self.close = self._publisher.undeclare

    def offer(self, image: Image, tracks: Tracks) -> None:
        """Publish a frame if one is due and there is a subscriber."""
        now = time.monotonic()
        if now < self._due or not self._publisher.matching_status.matching:
            return
        self._due = now + self._period
        image, pixels = reduced(image, tracks.pixels)
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


def reduced(image: Image, pixels: Pixels) -> tuple[Image, Pixels]:
    """Reduce an image, uint8 [H, W] or [H, W, 3], to at most 960 px, and scale features [N, 2] in it."""
    height, width = image.shape[:2]
    scale = _PREVIEW_EDGE / max(height, width)
    if scale >= 1:
        return image, pixels
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    # Pixel centres have integer coordinates: the image starts at -0.5.
    shares = np.array([size[0] / width, size[1] / height], np.float32)
    return small, (pixels + 0.5) * shares - 0.5
