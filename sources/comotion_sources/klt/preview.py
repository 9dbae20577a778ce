"""Delays frames of a live preview until their hypotheses are known."""

from collections import deque
from collections.abc import Sequence
from typing import Protocol

from comotion_schemas import Hypothesis

from ..cameras.types import Image
from .drawing import Annotator
from .picture_file import PictureFile
from .tracker import Tracks


class Fused(Protocol):
    """What the service has fused; see :class:`comotion_sources.klt.feed.HypothesisFeed`."""

    stamp_ns: int | None
    listed: Sequence[Hypothesis]

    def hypothesis(self, feature: int) -> int:
        """Return the hypothesis of a feature."""


class DelayedPreview:
    """Delays frames until the service has fused them, or a time limit has passed.

    Parameters
    ----------
    file
        Output of the annotated images.
    annotator
        Draws them.
    feed
        Says what is fused.
    max_delay_ns
        Longest delay of a frame behind the newest one.
    """

    def __init__(
        self,
        file: PictureFile,
        annotator: Annotator,
        feed: Fused,
        max_delay_ns: int = 1_500_000_000,
    ) -> None:
        self._file = file
        self._annotator = annotator
        self._feed = feed
        self._max_delay_ns = max_delay_ns
        self._held: deque[tuple[Image, Tracks]] = deque()

    @property
    def waiting(self) -> bool:
        """Whether the newest delayed frame may still be fused."""
        return bool(self._held) and self._feed.stamp_ns is not None and not self._is_due(self._held[-1][1])

    def add(self, image: Image, tracks: Tracks) -> None:
        """Add a frame and write the frames that are due."""
        self._held.append((image, tracks))
        newest = tracks.stamp_ns
        while self._held and (
            self._is_due(self._held[0][1]) or newest - self._held[0][1].stamp_ns > self._max_delay_ns
        ):
            self._write()

    def close(self) -> None:
        """Write the remaining frames and close the file."""
        while self._held:
            self._write()
        self._file.close()

    def _is_due(self, tracks: Tracks) -> bool:
        fused = self._feed.stamp_ns
        return fused is None or fused >= tracks.stamp_ns

    def _write(self) -> None:
        image, tracks = self._held.popleft()
        self._file.write(self._annotator.draw(image, tracks, self._feed.hypothesis, self._feed.listed))
