"""Segments a video offline: every frame is tracked, grouped and drawn. No process, no router.

The same file gives the same result on every run: the clock is that of the frames.
"""

import csv
import hashlib
import logging
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
from comotion_schemas.doubts import too_seldom
from comotion_schemas.errors import InputError
from comotion_schemas.naming import joint_words
from comotion_sources.cameras.opening import open_frames
from comotion_sources.klt.drawing import Annotator
from comotion_sources.klt.observer import CameraSpace
from comotion_sources.klt.picture_file import PictureFile

from .contact_sheet import ContactSheet
from .labelled import BlankFrames, Labelled, LabelledFrames, SegmentOptions
from .masks import MaskFolder

__all__ = ["COLUMNS", "Labelled", "Progress", "SegmentOptions", "Segmented", "segment"]

COLUMNS = ("frame", "time", "feature", "x", "y", "hypothesis", "confidence")
_DEFAULT_RATE = 30.0
_log = logging.getLogger(__name__)
Progress = Callable[[int, int | None], None]
"""Called with the frames done and, if known, the frames in all."""


@dataclass
class Segmented:
    """Summary of a run."""

    frames: int = 0
    seconds: float = 0.0  # wall time that they took
    duration: float = 0.0  # s, from the first to the last frame
    size: tuple[int, int] = (0, 0)  # width and height, px
    codec: str | None = None  # of the written video; None without one
    digest: str = ""  # SHA-256 of all labels: two runs with the same digest have the same labels
    hypotheses: Counter[int] = field(default_factory=Counter)  # frames in which each has a feature, by id
    last: Sequence[Hypothesis] = ()  # of the last update
    path: Sequence[tuple[int, Pose]] = ()  # of a carried camera in the world, where known: once per update
    joints: Sequence[str] = ()  # of the last update, in words

    def as_json(self) -> dict[str, Any]:
        """As plain values."""
        states = {h.id: h.state for h in self.last}
        return {
            "frames": self.frames,
            "duration_s": round(self.duration, 6),
            "frames_per_s": round(self.frames / self.seconds, 2) if self.seconds else None,
            "size": list(self.size),
            "codec": self.codec,
            "labels_sha256": self.digest,
            "hypotheses": [
                {"id": number, "frames": count, "state": states.get(number)}
                for number, count in sorted(self.hypotheses.items())
            ],
        }


def segment(what: str | None, options: SegmentOptions, progress: Progress = lambda *_: None) -> Segmented:
    """Segment a video file, a folder of images or of TUM RGB-D, or ``workcell:SCENE/CAMERA``.

    Without any of these, the tracks that are given are drawn on black.

    Raises
    ------
    InputError
        If it cannot be read, is a live camera, or an output cannot be written.
    """
    result, digest = Segmented(), hashlib.sha256()
    if what is not None:
        camera = open_frames(what, options.rate)
    elif options.given is not None:
        camera = BlankFrames(options.given)
    else:
        raise InputError("there is neither a video nor tracks")
    with ExitStack() as stack:
        stack.callback(camera.close)
        # The arrays of one update are too small to be worth waking other cores for.
        stack.enter_context(threadpool_limits(limits=1))
        run = LabelledFrames(camera, options)
        compile_ahead(options.fusion.method, run.space.unit, run.space.dim)
        begun = time.perf_counter()
        outputs = _Outputs(options, camera.rate or options.rate or _DEFAULT_RATE, run.space, stack)
        first_ns: int | None = None
        for labelled in run.labelled():
            first_ns = labelled.frame.stamp_ns if first_ns is None else first_ns
            result.duration = (labelled.frame.stamp_ns - first_ns) / 1e9
            outputs.write(labelled, result.duration)
            labels = labelled.hypotheses
            for part in (np.int64(labelled.number), labelled.tracks.ids, labels):
                digest.update(part.tobytes())
            result.frames += 1
            result.size = (labelled.frame.image.shape[1], labelled.frame.image.shape[0])
            result.hypotheses.update(np.unique(labels[labels >= 0]).tolist())
            result.last = labelled.listed
            progress(result.frames, camera.frames)
    if not result.frames:
        raise InputError(f"{what}: no frame")
    step_s = result.duration / max(result.frames - 1, 1)
    if seldom := too_seldom(step_s, options.fusion.track_timeout, run.space.unit):
        _log.warning("%s: %s", what, seldom)
    if options.sheet is not None:
        outputs.sheet.write(options.sheet)
    result.digest, result.path = digest.hexdigest(), run.path
    result.codec = None if outputs.picture is None else outputs.picture.codec
    result.joints = [joint_words(joint, options.names) for joint in run.joints if joint.point is not None]
    result.seconds = time.perf_counter() - begun
    return result


class _Outputs:
    """The files of one run, which the stack closes; the sheet is written when all has been seen."""

    def __init__(self, options: SegmentOptions, rate: float, space: CameraSpace, stack: ExitStack) -> None:
        self._options = options
        self._annotator = Annotator(space, options.names)
        self.sheet = ContactSheet()
        self._masks = None if options.masks is None else MaskFolder(options.masks, options.masks_every)
        self._table: Any = None
        if options.csv is not None:
            try:
                options.csv.parent.mkdir(parents=True, exist_ok=True)
                file = stack.enter_context(options.csv.open("w", newline="", encoding="utf-8"))
            except OSError as error:
                raise InputError(f"{options.csv}: {error.strerror}") from None
            self._table = csv.writer(file)
            self._table.writerow(COLUMNS)
        self.picture = None if options.out is None else PictureFile(options.out, rate)
        if self.picture is not None:
            stack.callback(self.picture.close)

    def write(self, labelled: Labelled, seconds: float) -> None:
        """Write one frame, so many seconds after the first."""
        if self._table is not None:
            self._table.writerows(_rows(labelled, seconds))
        if self._masks is not None:
            self._masks.write(labelled)
        if self.picture is None and self._options.sheet is None:
            return
        labels = np.where(labelled.hypotheses >= 0, labelled.hypotheses, UNDETERMINED).tolist()
        label_of = dict(zip(labelled.tracks.ids.tolist(), labels, strict=True))
        image = self._annotator.draw(
            labelled.frame.image, labelled.tracks, label_of.__getitem__, labelled.listed
        )
        if self.picture is not None:
            self.picture.write(image)
        if self._options.sheet is not None:
            self.sheet.add(image, seconds)


def _rows(labelled: Labelled, seconds: float) -> Iterator[tuple[Any, ...]]:
    tracks = labelled.tracks
    columns = (tracks.ids, tracks.pixels, labelled.hypotheses, labelled.confidence)
    for feature, (x, y), hypothesis, confidence in zip(*(c.tolist() for c in columns), strict=True):
        frame = (labelled.number, f"{seconds:.6f}", feature)
        yield *frame, f"{x:.3f}", f"{y:.3f}", hypothesis, f"{confidence:.3f}"
