"""Segments a video offline: every frame is tracked, grouped and drawn. No process, no router.

The same file gives the same result on every run: the clock is that of the frames.
"""

import csv
import hashlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from comotion.library.compiling import compile_ahead
from comotion_schemas import UNDETERMINED, Hypothesis, Pose
from comotion_schemas.naming import joint_words
from comotion_sources.cameras.opening import open_frames
from comotion_sources.cameras.types import Camera, CameraError
from comotion_sources.klt.drawing import Annotator
from comotion_sources.klt.observer import CameraSpace
from comotion_sources.klt.picture_file import PictureFile

from .contact_sheet import ContactSheet
from .given_tracks import BlankFrames
from .labelled import Labelled, LabelledFrames, SegmentOptions
from .masks import MaskFolder

__all__ = ["COLUMNS", "Labelled", "Progress", "SegmentOptions", "Segmented", "segment"]

COLUMNS = ("frame", "time", "feature", "x", "y", "hypothesis", "confidence")
_DEFAULT_RATE = 30.0
Progress = Callable[[int, int | None], None]
"""Called with the frames done and, if known, the frames in all."""


@dataclass
class Segmented:
    """Summary of a run.

    Attributes
    ----------
    frames, seconds
        Number of frames, and wall time that they took.
    duration
        s, from the first to the last frame.
    size
        Width and height, px.
    codec
        Of the written video; None without one.
    digest
        SHA-256 of all labels: two runs with the same digest have the same labels.
    hypotheses
        Frames in which each hypothesis has a feature, by id.
    last
        The hypotheses of the last update.
    path
        Stamp and pose of a carried camera in the world, where it is known: once per update.
    joints
        Those of the last update, in words.
    """

    frames: int = 0
    seconds: float = 0.0
    duration: float = 0.0
    size: tuple[int, int] = (0, 0)
    codec: str | None = None
    digest: str = ""
    hypotheses: Counter[int] = field(default_factory=Counter)
    last: Sequence[Hypothesis] = ()
    path: Sequence[tuple[int, Pose]] = ()
    joints: Sequence[str] = ()

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "frames": self.frames,
            "duration_s": round(self.duration, 6),
            "frames_per_s": round(self.frames / self.seconds, 2) if self.seconds else None,
            "size": list(self.size),
            "codec": self.codec,
            "labels_sha256": self.digest,
            "hypotheses": [
                {"id": number, "frames": count, "state": state}
                for number, count in sorted(self.hypotheses.items())
                for state in [next((h.state for h in self.last if h.id == number), None)]
            ],
        }


def segment(what: str | None, options: SegmentOptions, progress: Progress = lambda *_: None) -> Segmented:
    """Segment a video file, a folder of images or of TUM RGB-D, or ``workcell:SCENE/CAMERA``.

    Without any of these, the tracks that are given are drawn on black.

    Raises
    ------
    CameraError
        If it cannot be read, is a live camera, or an output cannot be written.
    """
    result, digest = Segmented(), hashlib.sha256()
    camera = _camera(what, options)
    total = camera.frames
    with ExitStack() as stack:
        stack.callback(camera.close)
        # The arrays of one update are too small to be worth waking other cores for.
        stack.enter_context(threadpool_limits(limits=1))
        run = LabelledFrames(camera, options)
        compile_ahead(options.fusion.method, run.space.unit, run.space.dim)
        begun = time.perf_counter()
        outputs = _Outputs(options, camera.rate or options.rate or _DEFAULT_RATE, run.space)
        stack.callback(outputs.close)
        first_ns: int | None = None
        for labelled in run.labelled():
            outputs.write(labelled)
            _add(digest, labelled)
            first_ns = labelled.frame.stamp_ns if first_ns is None else first_ns
            result.frames += 1
            result.duration = (labelled.frame.stamp_ns - first_ns) / 1e9
            result.size = (labelled.frame.image.shape[1], labelled.frame.image.shape[0])
            result.hypotheses.update(np.unique(labelled.hypotheses[labelled.hypotheses >= 0]).tolist())
            result.last = labelled.listed
            progress(result.frames, total)
    if not result.frames:
        raise CameraError(f"{what}: no frame")
    outputs.finish()
    result.digest, result.codec, result.path = digest.hexdigest(), outputs.codec, run.path
    result.joints = [joint_words(joint, options.names) for joint in run.joints if joint.point is not None]
    result.seconds = time.perf_counter() - begun
    return result


def _camera(what: str | None, options: SegmentOptions) -> Camera:
    if what is not None:
        return open_frames(what, options.rate)
    if options.given is None:
        raise CameraError("there is neither a video nor tracks")
    return BlankFrames(options.given)


class _Outputs:
    """The files of one run; the last is the sheet, which :meth:`finish` writes."""

    def __init__(self, options: SegmentOptions, rate: float, space: CameraSpace) -> None:
        self._annotator = Annotator(space, options.names)
        self._picture = None if options.out is None else PictureFile(options.out, rate)
        self.codec = None if self._picture is None else self._picture.codec
        self._sheet = None if options.sheet is None else ContactSheet()
        self._sheet_path = options.sheet
        self._first_ns: int | None = None
        self._table: Any = None
        self._file = None
        self._masks = None if options.masks is None else MaskFolder(options.masks, options.masks_every)
        if options.csv is not None:
            try:
                options.csv.parent.mkdir(parents=True, exist_ok=True)
                self._file = options.csv.open("w", newline="", encoding="utf-8")
            except OSError as error:
                raise CameraError(f"{options.csv}: {error.strerror}") from None
            self._table = csv.writer(self._file)
            self._table.writerow(COLUMNS)

    def write(self, labelled: Labelled) -> None:
        """Write one frame."""
        if self._first_ns is None:
            self._first_ns = labelled.frame.stamp_ns
        seconds = (labelled.frame.stamp_ns - self._first_ns) / 1e9
        if self._table is not None:
            self._table.writerows(_rows(labelled, seconds))
        if self._masks is not None:
            self._masks.write(labelled)
        if self._picture is not None or self._sheet is not None:
            labels = dict(zip(labelled.tracks.ids.tolist(), labelled.hypotheses.tolist(), strict=True))
            image = self._annotator.draw(
                labelled.frame.image,
                labelled.tracks,
                lambda feature: labels[feature] if labels[feature] >= 0 else UNDETERMINED,
                labelled.listed,
            )
            if self._picture is not None:
                self._picture.write(image)
            if self._sheet is not None:
                self._sheet.add(image, seconds)

    def finish(self) -> None:
        """Write the sheet of what was seen."""
        if self._sheet is not None and self._sheet_path is not None:
            self._sheet.write(self._sheet_path)

    def close(self) -> None:
        """Complete the files."""
        if self._file is not None:
            self._file.close()
        if self._picture is not None:
            self._picture.close()


def _rows(labelled: Labelled, seconds: float) -> Iterator[tuple[Any, ...]]:
    columns = zip(
        labelled.tracks.ids.tolist(),
        labelled.tracks.pixels.tolist(),
        labelled.hypotheses.tolist(),
        labelled.confidence.tolist(),
        strict=True,
    )
    frame = (labelled.number, f"{seconds:.6f}")
    for feature, (x, y), hypothesis, confidence in columns:
        yield *frame, feature, f"{x:.3f}", f"{y:.3f}", hypothesis, f"{confidence:.3f}"


def _add(digest: Any, labelled: Labelled) -> None:
    digest.update(np.int64(labelled.number).tobytes())
    digest.update(labelled.tracks.ids.tobytes())
    digest.update(labelled.hypotheses.tobytes())
