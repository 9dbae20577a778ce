"""Video -> video, offline: every frame of a camera file is tracked, grouped and drawn. No process, no router.

The same file gives the same result on every run: the clock is that of the frames.
"""

import csv
import hashlib
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from comotion import Fusion, FusionConfig
from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, ObservationBatch, Pose
from comotion_sources.calibration import Calibration
from comotion_sources.cameras.opening import open_frames
from comotion_sources.cameras.types import Camera, CameraError, Frame
from comotion_sources.frames import MessageBuilder
from comotion_sources.klt import Tracker, TrackerConfig, Tracks
from comotion_sources.klt.drawing import Annotator
from comotion_sources.klt.observer import CameraSpace, Observer, choose_space
from comotion_sources.klt.picture_file import PictureFile
from comotion_sources.streams import OFFLINE_SESSION

COLUMNS = ("frame", "time", "feature", "x", "y", "hypothesis", "confidence")
_SOURCE = "video"
_DEFAULT_RATE = 30.0
Progress = Callable[[int, int | None], None]
"""Called with the frames done and, if known, the frames in all."""


@dataclass(frozen=True, kw_only=True)
class SegmentOptions:
    """What is written, and how the video is tracked.

    Attributes
    ----------
    out
        Video (``.mp4``, ``.mkv``, ``.mov``, ``.avi``) or folder of PNG files; None: none.
    csv
        Table with a row per feature and frame; None: none.
    rate
        Frames per second of a folder of images.
    tracker
        Of which `moving` says that the camera is carried.
    calibration
        Intrinsics and extrinsics of a camera with depth, if its recording has none.
    use_depth
        Group in metres where there is depth; else in pixels.
    """

    out: Path | None = None
    csv: Path | None = None
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)
    rate: float | None = None
    calibration: Calibration = field(default_factory=Calibration)
    use_depth: bool = True


class Labelled(NamedTuple):
    """One frame with the labels of the update that has fused it.

    `hypotheses` int64 [N], negative for undetermined, and `confidence` float64 [N] go with `tracks`;
    `listed` are all hypotheses of the update.
    """

    number: int
    frame: Frame
    tracks: Tracks
    hypotheses: NDArray[np.int64]
    confidence: NDArray[np.float64]
    listed: Sequence[Hypothesis]


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
                {"id": one, "frames": count, "state": state}
                for one, count in sorted(self.hypotheses.items())
                for state in [next((h.state for h in self.last if h.id == one), None)]
            ],
        }


def segment(what: str, options: SegmentOptions, progress: Progress = lambda *_: None) -> Segmented:
    """Segment a video file, a folder of images or of TUM RGB-D, or ``workcell:SCENE/CAMERA``.

    Raises
    ------
    CameraError
        If it cannot be read, is a live camera, or an output cannot be written.
    """
    begun, found, digest = time.perf_counter(), Segmented(), hashlib.sha256()
    camera = open_frames(what, options.rate)
    total = getattr(camera, "frames", None)
    with ExitStack() as stack:
        stack.callback(camera.close)
        # The arrays of one update are too small to be worth waking other cores for.
        stack.enter_context(threadpool_limits(limits=1))
        run = _Run(camera, options)
        outputs = _Outputs(options, camera.rate or options.rate or _DEFAULT_RATE, run.space)
        stack.callback(outputs.close)
        first_ns: int | None = None
        for one in run.labelled():
            outputs.write(one)
            _add(digest, one)
            first_ns = one.frame.stamp_ns if first_ns is None else first_ns
            found.frames += 1
            found.duration = (one.frame.stamp_ns - first_ns) / 1e9
            found.size = (one.frame.image.shape[1], one.frame.image.shape[0])
            found.hypotheses.update(np.unique(one.hypotheses[one.hypotheses >= 0]).tolist())
            found.last = one.listed
            progress(found.frames, total)
    if not found.frames:
        raise CameraError(f"{what}: no frame")
    found.digest, found.codec, found.path = digest.hexdigest(), outputs.codec, run.path
    found.seconds = time.perf_counter() - begun
    return found


class _Run:
    """Tracks and groups the frames of one camera."""

    def __init__(self, camera: Camera, options: SegmentOptions) -> None:
        if camera.live:
            raise CameraError("a live camera has no end: use comotion source klt")
        self._camera = camera
        given = options.calibration
        intrinsics = given.intrinsics or camera.intrinsics
        has_depth = camera.has_depth and options.use_depth
        self.space = choose_space(
            _SOURCE,
            has_depth=has_depth,
            intrinsics=intrinsics,
            extrinsics=None if options.tracker.moving else given.extrinsics or camera.extrinsics,
        )
        self.path: list[tuple[int, Pose]] = []
        self._tracker = Tracker(options.tracker, self.space.intrinsics)
        builder = MessageBuilder(
            source=_SOURCE,
            session=OFFLINE_SESSION,
            space=self.space.name,
            unit=self.space.unit,
            dim=self.space.dim,
            moving=options.tracker.moving,
        )
        self._observer = Observer(self.space, builder)
        self._fusion = Fusion(options.fusion, scene="segment")
        self._period_ns = round(options.fusion.period * 1e9)
        self._held: deque[tuple[int, Frame, Tracks]] = deque()
        self._labels: dict[int, tuple[int, float]] = {}

    def labelled(self) -> Iterator[Labelled]:
        """Yield every frame once the update after it is there."""
        due_ns, last_ns = 0, None
        for number, frame in enumerate(self._camera):
            if last_ns is not None and frame.stamp_ns <= last_ns:
                continue  # a repeated frame has no time of its own
            if last_ns is None:
                due_ns = frame.stamp_ns
            last_ns = frame.stamp_ns
            self._take(number, frame)
            if frame.stamp_ns >= due_ns:
                due_ns = frame.stamp_ns + self._period_ns
                yield from self._release(self._fusion.update(frame.stamp_ns))
        if self._held and last_ns is not None:
            yield from self._release(self._fusion.update(last_ns))

    def _take(self, number: int, frame: Frame) -> None:
        depth = frame.depth if self.space.dim == 3 else None
        seen = Frame(frame.stamp_ns, frame.image, depth, None)
        tracks = self._tracker.step(seen)
        for message in self._observer.messages(tracks, seen):
            if isinstance(message, ObservationBatch):
                self._fusion.ingest(message)
        self._held.append((number, frame, tracks))

    def _release(self, update: HypothesisUpdate) -> Iterator[Labelled]:
        self.path += [(update.stamp_ns, pose) for pose in update.frames.values()]
        labels = dict(
            zip(
                update.track_id.tolist(),
                zip(update.track_hypothesis.tolist(), update.track_confidence.tolist(), strict=True),
                strict=True,
            )
        )
        # A feature that was lost since the last update keeps what was known of it.
        known = self._labels | labels
        self._labels = labels
        while self._held:
            number, frame, tracks = self._held.popleft()
            rows = [known.get(one, (UNDETERMINED, 0.0)) for one in tracks.ids.tolist()]
            table = np.array(rows, np.float64).reshape(-1, 2)
            hypotheses = table[:, 0].astype(np.int64)
            hypotheses[hypotheses == UNDETERMINED] = -1
            yield Labelled(number, frame, tracks, hypotheses, table[:, 1], update.hypotheses)


class _Outputs:
    """The files of one run."""

    def __init__(self, options: SegmentOptions, rate: float, space: CameraSpace) -> None:
        self._annotator = Annotator(space)
        self._picture = None if options.out is None else PictureFile(options.out, rate)
        self.codec = None if self._picture is None else self._picture.codec
        self._first_ns: int | None = None
        self._table: Any = None
        self._file = None
        if options.csv is not None:
            try:
                options.csv.parent.mkdir(parents=True, exist_ok=True)
                self._file = options.csv.open("w", newline="", encoding="utf-8")
            except OSError as error:
                raise CameraError(f"{options.csv}: {error.strerror}") from None
            self._table = csv.writer(self._file)
            self._table.writerow(COLUMNS)

    def write(self, one: Labelled) -> None:
        """Write one frame."""
        if self._first_ns is None:
            self._first_ns = one.frame.stamp_ns
        if self._table is not None:
            self._table.writerows(_rows(one, (one.frame.stamp_ns - self._first_ns) / 1e9))
        if self._picture is not None:
            labels = dict(zip(one.tracks.ids.tolist(), one.hypotheses.tolist(), strict=True))
            image = self._annotator.draw(
                one.frame.image,
                one.tracks,
                lambda feature: labels[feature] if labels[feature] >= 0 else UNDETERMINED,
                one.listed,
            )
            self._picture.write(image)

    def close(self) -> None:
        """Complete the files."""
        if self._file is not None:
            self._file.close()
        if self._picture is not None:
            self._picture.close()


def _rows(one: Labelled, seconds: float) -> Iterator[tuple[Any, ...]]:
    columns = zip(
        one.tracks.ids.tolist(),
        one.tracks.pixels.tolist(),
        one.hypotheses.tolist(),
        one.confidence.tolist(),
        strict=True,
    )
    for feature, (x, y), hypothesis, confidence in columns:
        yield one.number, f"{seconds:.6f}", feature, f"{x:.3f}", f"{y:.3f}", hypothesis, f"{confidence:.3f}"


def _add(digest: Any, one: Labelled) -> None:
    digest.update(np.int64(one.number).tobytes())
    digest.update(one.tracks.ids.tobytes())
    digest.update(one.hypotheses.tobytes())
