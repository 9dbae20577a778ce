"""Shows a whole video on one page: annotated frames at equal distances, in a JPEG file."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

COLUMNS, ROWS = 3, 4
LIMIT = 300_000
"""Bytes that a file should not exceed."""
_WIDTH = 480  # px of a picture, at most
_QUALITIES = (88, 80, 70, 60, 50, 30)
_SPARE = 4  # times as many are kept as are shown, so that these are at equal distances


class ContactSheet:
    """Takes all frames of a video, however long it is, and writes :data:`COLUMNS` x :data:`ROWS` of them."""

    def __init__(self) -> None:
        self._kept: list[tuple[float, NDArray[np.uint8]]] = []
        self._every, self._left = 1, 0  # frames from one that is kept to the next

    def add(self, image: NDArray[np.uint8], seconds: float) -> None:
        """Add a frame uint8 [H, W, 3] (BGR) and its time from the first one, s."""
        if not self._left:
            scale = min(1.0, _WIDTH / image.shape[1])
            small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            self._kept.append((seconds, np.asarray(small, np.uint8)))
            if len(self._kept) == 2 * _SPARE * COLUMNS * ROWS:
                self._kept, self._every = self._kept[1::2], 2 * self._every
            self._left = self._every
        self._left -= 1

    def write(self, path: Path) -> None:
        """Write the page: the last frame of each of equal parts of the video.

        Raises
        ------
        InputError
            If there was no frame, or the file cannot be written.
        """
        parts = min(COLUMNS * ROWS, len(self._kept))
        if not parts:
            raise InputError(f"{path}: there is no frame to show")
        shown = (self._kept[(k + 1) * len(self._kept) // parts - 1] for k in range(parts))
        pictures = [_timed(image, seconds) for seconds, image in shown]
        pictures += [np.zeros_like(pictures[0])] * (-len(pictures) % COLUMNS)
        rows = [np.hstack(pictures[k : k + COLUMNS]) for k in range(0, len(pictures), COLUMNS)]
        for quality in _QUALITIES:
            _, data = cv2.imencode(".jpg", np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, quality])
            if len(data) <= LIMIT:
                break
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data.tobytes())
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}") from None


def _timed(image: NDArray[np.uint8], seconds: float) -> NDArray[np.uint8]:
    """A picture with its time at the lower left, and a thin frame."""
    image = image.copy()
    height, width = image.shape[:2]
    text, font = f"{seconds:.1f} s", cv2.FONT_HERSHEY_SIMPLEX
    (across, up), _ = cv2.getTextSize(text, font, 0.55, 1)
    cv2.rectangle(image, (0, height - up - 14), (across + 14, height), (30, 30, 30), cv2.FILLED)
    cv2.putText(image, text, (7, height - 8), font, 0.55, (255, 255, 255), 1, cv2.LINE_AA)
    cv2.rectangle(image, (0, 0), (width - 1, height - 1), (30, 30, 30), 1)
    return image
