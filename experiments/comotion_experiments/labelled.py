"""Labels the features of every frame of a camera file, or of tracks without a video, offline."""

import logging
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comotion import Fusion, FusionConfig
from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Joint, ObservationBatch, Pose
from comotion_schemas.errors import InputError
from comotion_schemas.naming import Names
from comotion_sources.calibration.files import Calibration
from comotion_sources.cameras.files import RecordedCamera
from comotion_sources.cameras.types import Camera, Frame
from comotion_sources.klt.config import TrackerConfig
from comotion_sources.klt.observer import Observer, choose_space
from comotion_sources.klt.tracker import Tracker, Tracks
from comotion_sources.recordings import Recording
from comotion_sources.streams import OFFLINE_SESSION

_SOURCE = "video"
_LARGEST_PX = 4096
# A hypothesis is shown if it is in so many frames: others are taken back, or become one that was known. And
# frames that wait at most: a second of large ones takes a gigabyte.
_LASTS, _MOST_HELD = 10, 30
# ns; a feature has the label that it has most in so much of what follows: motion is understood belatedly.
_AHEAD_NS = 700_000_000
_NONE = UNDETERMINED, 0.0
# Hypotheses of features, and how probable each is, by feature.
_Labels = dict[int, tuple[int, float]]
_Listed = dict[int, Hypothesis]
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class SegmentOptions:
    """What is written (None: not), and how the video is tracked."""

    out: Path | None = None  # video (``.mp4``, ``.mkv``, ``.mov``, ``.avi``) or folder of PNG files
    csv: Path | None = None  # table with a row per feature and frame
    sheet: Path | None = None  # JPEG file with frames of the whole video (:mod:`.contact_sheet`)
    masks: Path | None = None  # folder of images with the hypothesis of every pixel
    masks_every: float = 0.5  # s between two of them
    tracker: TrackerConfig = field(default_factory=TrackerConfig)  # `moving`: the camera is carried
    fusion: FusionConfig = field(default_factory=FusionConfig)
    rate: float | None = None  # frames per second of a folder of images
    # Intrinsics and extrinsics of a camera with depth, if its recording has none.
    calibration: Calibration = field(default_factory=Calibration)
    use_depth: bool = True  # group in metres where there is depth; else in pixels
    given: Recording | None = None  # tracks in pixels of the frames, grouped in place of those of the tracker
    names: Names = field(default_factory=dict)  # of hypotheses by id, drawn in place of the ids


class Labelled(NamedTuple):
    """One frame with the labels of the update that has fused it.

    `hypotheses` int64 [N], negative for undetermined, and `confidence` float64 [N] go with `tracks`;
    `listed` are all hypotheses of the update, and those that the features have soon.
    """

    number: int
    frame: Frame
    tracks: Tracks
    hypotheses: NDArray[np.int64]
    confidence: NDArray[np.float64]
    listed: Sequence[Hypothesis]


class GivenTracks:
    """The tracks of a recording, whose instants are the frames of a video, as those of its frames.

    Raises
    ------
    InputError
        If the recording is in metres.
    """

    def __init__(self, recording: Recording, camera: Camera) -> None:
        if recording.dim != 2:
            raise InputError(f"{recording.name}: its tracks are in m; in an image they are in px")
        frames = camera.frames
        if frames not in {None, len(recording)}:
            first = min(frames, len(recording))
            text = "%s has %d frames, the video %d: the first %d are used"
            _log.warning(text, recording.name, len(recording), frames, first)
        self._frames = list(recording)

    def __len__(self) -> int:
        return len(self._frames)

    def at(self, number: int, frame: Frame) -> Tracks:
        """The features of a frame, by its number."""
        tracked = self._frames[number]
        count = len(tracked.ids)
        return Tracks(
            stamp_ns=frame.stamp_ns,
            ids=tracked.ids,
            pixels=tracked.positions.astype(np.float32),
            positions=tracked.positions,
            sigma=np.full(count, np.nan) if tracked.sigma is None else tracked.sigma,
            born=np.zeros(count, np.bool_),  # where truth is to be read: there is none
            ended=tracked.ended,
        )


class BlankFrames(RecordedCamera):
    """Black frames that are as large as tracks need, at their times."""

    def __init__(self, recording: Recording) -> None:
        super().__init__(recording.rate, len(recording))
        extent = np.nanmax(recording.positions.reshape(-1, recording.dim), axis=0)[:2]
        # Encoders want even sizes.
        width, height = (np.clip(np.ceil((extent + 1) / 2), 8, _LARGEST_PX / 2).astype(int) * 2).tolist()
        self._shape, self._times = (height, width, 3), recording.times

    def _read(self) -> Iterator[Frame]:
        for t in self._times.tolist():
            yield Frame(round(t * 1e9), np.zeros(self._shape, np.uint8))


class LabelledFrames:
    """Tracks and groups the frames of one camera; `path` is that of a carried one, `joints` the last ones."""

    def __init__(self, camera: Camera, options: SegmentOptions) -> None:
        if camera.live:
            raise InputError("a live camera has no end: use comotion source klt")
        self._camera = camera
        given = options.calibration
        intrinsics = given.intrinsics or camera.intrinsics
        has_depth = camera.has_depth and options.use_depth and options.given is None
        self.space = choose_space(
            _SOURCE,
            has_depth=has_depth,
            intrinsics=intrinsics,
            extrinsics=None if options.tracker.moving else given.extrinsics or camera.extrinsics,
        )
        self.path: list[tuple[int, Pose]] = []
        self._given = None if options.given is None else GivenTracks(options.given, camera)
        self.joints: Sequence[Joint] = ()
        self._tracker = Tracker(options.tracker, self.space.intrinsics)
        builder = self.space.builder(_SOURCE, OFFLINE_SESSION, moving=options.tracker.moving)
        self._observer = Observer(self.space, builder)
        self._fusion = Fusion(options.fusion, scene="segment")
        self._period_ns = round(options.fusion.period * 1e9)
        self._lasting: set[int] = set()
        self._held: deque[tuple[int, Frame, Tracks, _Labels, _Listed]] = deque()
        self._labels: _Labels = {}

    def labelled(self) -> Iterator[Labelled]:
        """Yield every frame once the hypotheses in it have lasted, or have not."""
        due_ns, last_ns = 0, None
        for number, frame in enumerate(self._camera):
            if self._given is not None and number >= len(self._given):
                break
            if last_ns is not None and frame.stamp_ns <= last_ns:
                continue  # a repeated frame has no time of its own
            if last_ns is None:
                due_ns = frame.stamp_ns
            last_ns = frame.stamp_ns
            depth = frame.depth if self.space.dim == 3 else None
            seen = Frame(frame.stamp_ns, frame.image, depth, None)
            tracks = self._tracker.step(seen) if self._given is None else self._given.at(number, seen)
            for message in self._observer.messages(tracks, seen):
                if isinstance(message, ObservationBatch):
                    self._fusion.ingest(message)
            self._held.append((number, frame, tracks, {}, {}))
            if frame.stamp_ns >= due_ns:
                due_ns = frame.stamp_ns + self._period_ns
                yield from self._release(self._fusion.update(frame.stamp_ns))
        if self._held and last_ns is not None:
            yield from self._release(self._fusion.update(last_ns), ended=True)

    def _release(self, update: HypothesisUpdate, *, ended: bool = False) -> Iterator[Labelled]:
        """Yield the frames of which enough that follows is known, or all."""
        self.joints = update.joints
        self.path += [(update.stamp_ns, pose) for pose in update.frames.values()]
        rows = zip(update.track_hypothesis.tolist(), update.track_confidence.tolist(), strict=True)
        labels = dict(zip(update.track_id.tolist(), rows, strict=True))
        # A feature that was lost since the last update keeps what was known of it.
        latest = self._labels | labels
        self._labels = labels
        # Boxes are those of a frame's own update, as bodies move on.
        listed = {h.id: h for h in update.hypotheses}
        self._held = deque(
            (n, frame, tracks, known or latest, of or listed) for n, frame, tracks, known, of in self._held
        )
        newest_ns = self._held[-1][1].stamp_ns
        while self._held:
            known = newest_ns - self._held[0][1].stamp_ns >= _AHEAD_NS or len(self._held) > _MOST_HELD
            if not ended and (len(self._held) < _LASTS or not known):
                break
            self._note_lasting()
            number, frame, tracks, _, own = self._held[0]
            labelled = self._shown(tracks.ids.tolist())
            self._held.popleft()
            table = np.array(labelled, np.float64).reshape(-1, 2)
            hypotheses = table[:, 0].astype(np.int64)
            hypotheses[hypotheses == UNDETERMINED] = -1
            yield Labelled(number, frame, tracks, hypotheses, table[:, 1], list((listed | own).values()))

    def _note_lasting(self) -> None:
        """Note which hypotheses are in enough of the frames that wait; of a shorter video, in all."""
        frames: Counter[int] = Counter()
        for _, _, tracks, labels, _ in self._held:
            frames.update({labels.get(feature, _NONE)[0] for feature in tracks.ids.tolist()})
        least = min(_LASTS, self._held[-1][0] + 1)
        self._lasting |= {name for name, count in frames.items() if count >= least and name != UNDETERMINED}

    def _shown(self, features: list[int]) -> list[tuple[int, float]]:
        """Labels of features in the first frame that waits: the lasting ones that each has most, or none."""
        until_ns = self._held[0][1].stamp_ns + _AHEAD_NS
        soon = [labels for _, frame, _, labels, _ in self._held if frame.stamp_ns < until_ns]
        shown = []
        for feature in features:
            had = [labels[feature] for labels in soon if feature in labels]
            counts = Counter(name for name, _ in had if name in self._lasting)
            most = max(counts, key=counts.__getitem__, default=UNDETERMINED)
            shown.append(next((label for label in had if label[0] == most), _NONE))
        return shown
