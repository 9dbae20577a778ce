"""Tracks of another tracker, frame by frame, and frames without a picture for tracks without a video."""

import logging
from collections.abc import Iterator

import numpy as np

from comotion_schemas.errors import InputError
from comotion_sources.cameras.files import RecordedCamera
from comotion_sources.cameras.types import Camera, Frame
from comotion_sources.klt.tracker import Tracks
from comotion_sources.recordings import Recording, recording_streams

_log = logging.getLogger(__name__)
_LARGEST_PX = 4096


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
        count = recording.positions.shape[1]
        (stream,) = recording_streams(recording)
        self._frames = list(stream)
        first = np.argmax(np.isfinite(recording.positions[..., 0]), axis=0)
        ids = np.arange(count) if recording.ids is None else recording.ids
        self._births = dict(zip(ids.tolist(), first.tolist(), strict=True))

    def __len__(self) -> int:
        return len(self._frames)

    def at(self, number: int, frame: Frame) -> Tracks:
        """The features of a frame, by its number."""
        tracked = self._frames[number]
        ids = tracked.ids.tolist()
        return Tracks(
            stamp_ns=frame.stamp_ns,
            ids=tracked.ids,
            pixels=tracked.positions.astype(np.float32),
            pixel_sigma=np.full(len(ids), np.nan) if tracked.sigma is None else tracked.sigma,
            points=None,
            sigma=None,
            born=np.array([self._births[identity] == number for identity in ids], np.bool_),
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

    def __iter__(self) -> Iterator[Frame]:
        for t in self._times.tolist():
            if self._closed:
                return
            yield Frame(round(t * 1e9), np.zeros(self._shape, np.uint8))
