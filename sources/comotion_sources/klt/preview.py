"""Delays frames of a live preview until their hypotheses are known."""

from collections import deque
from collections.abc import Callable, Sequence

from comotion_schemas import Hypothesis

from ..cameras.types import Image
from .drawing import Annotator
from .picture_file import PictureFile
from .tracker import Tracks


class DelayedPreview:
    """Delays frames until the service has fused them, or a time limit has passed.

    Parameters
    ----------
    file
        Output of the annotated images.
    annotator
        Draws them.
    hypothesis
        Maps a feature id to its hypothesis.
    hypotheses
        Returns all hypotheses of the newest update.
    fused_ns
        Returns the watermark of the service; None: there is no service.
    max_delay_ns
        Longest delay of a frame behind the newest one.
    """

    def __init__(
        self,
        file: PictureFile,
        annotator: Annotator,
        hypothesis: Callable[[int], int],
        hypotheses: Callable[[], Sequence[Hypothesis]],
        fused_ns: Callable[[], int | None],
        max_delay_ns: int = 1_500_000_000,
    ) -> None:
        self._file = file
        self._annotator = annotator
        self._hypothesis, self._hypotheses = hypothesis, hypotheses
        self._fused_ns = fused_ns
        self._max_delay_ns = max_delay_ns
        self._held: deque[tuple[Image, Tracks]] = deque()

    @property
    def waiting(self) -> bool:
        """Whether the newest delayed frame may still be fused."""
        return bool(self._held) and self._fused_ns() is not None and not self._is_due(self._held[-1][1])

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
        fused = self._fused_ns()
        return fused is None or fused >= tracks.stamp_ns

    def _write(self) -> None:
        image, tracks = self._held.popleft()
        self._file.write(self._annotator.draw(image, tracks, self._hypothesis, self._hypotheses()))
