"""Reads recordings of features: streams, whose markers may be divided among several sources."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.doubts import doubts
from comotion_schemas.errors import InputError, RecordingError
from comotion_schemas.recording import SUFFIX

from ..streams import Frame, Part, Stream, numbered, rate_of

DEFAULT_NAME = "replay"
_log = logging.getLogger(__name__)


@dataclass(eq=False, kw_only=True)
class Recording(Stream):
    """The content of a recording, or what one source has of it; may be iterated over repeatedly.

    A feature ends with its last observation. The space is ``world`` in m for 3-D, ``pixels`` in px for 2-D.

    Attributes
    ----------
    name
        Name of the file without its suffix, or of the source.
    times
        float64 [F], seconds, increasing, the first is 0.
    positions
        float64 [F, N, dim] in `unit`, rows of NaN where unobserved.
    labels
        int64 [N], number of the true object, -1 for ambiguous; None without truth.
    objects
        Names of the objects by number.
    sigma
        float64 [F, N], one-sigma noise of a position in `unit`, above 0 where observed; None: unknown.
    ids
        uint64 [N], ids of the features; by default their numbers.
    rate
        Instants per second; by default from the median interval.
    length
        Seconds after which it may be repeated; by default the time of the last instant plus one interval.
    """

    publish_sigma = True

    name: str
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    labels: NDArray[np.int64] | None = None
    objects: Mapping[int, str] = field(default_factory=dict)
    sigma: NDArray[np.float64] | None = None
    ids: NDArray[np.uint64] = None  # type: ignore[assignment] # their numbers
    rate: float = 0.0
    length: float = 0.0

    def __post_init__(self) -> None:
        self.dim = self.positions.shape[2]
        self.space, self.unit = ("pixels", "px") if self.dim == 2 else ("world", "m")
        if self.ids is None:
            self.ids = np.arange(self.positions.shape[1], dtype=np.uint64)
        if self.rate:
            return
        if len(self.times) < 2:
            raise RecordingError("it holds fewer than two instants")
        if not (np.diff(self.times) > 0).all():
            raise RecordingError("its times do not increase")
        if not np.isfinite(self.positions).any():
            raise RecordingError("it holds no observation")
        period = float(np.median(np.diff(self.times)))
        self.rate, self.length = 1.0 / period, float(self.times[-1]) + period

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[Frame]:
        seen = np.isfinite(self.positions[..., 0])
        # Index of the last observation; -2 where there is none, so that the feature never ends.
        last = np.where(seen.any(axis=0), len(seen) - 1 - np.argmax(seen[::-1], axis=0), -2)
        for k, t in enumerate(self.times.tolist()):
            now = seen[k]
            yield Frame(
                t=t,
                ids=self.ids[now],
                positions=self.positions[k, now],
                objects=None if self.labels is None else self.labels[now].astype(np.int32),
                ended=self.ids[last == k - 1],
                sigma=None if self.sigma is None else self.sigma[k, now],
            )


def clean(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Replace rows with a coordinate that is not finite, or beyond float32, by rows of NaN."""
    limit = np.finfo(np.float32).max
    with np.errstate(invalid="ignore"):
        finite: NDArray[np.bool_] = np.all(np.abs(positions) <= limit, axis=2)
    return np.where(finite[..., None], positions, np.nan)


def recording_streams(
    recording: Recording,
    *,
    split: int = 1,
    rates: Sequence[float] | None = None,
    source: str = DEFAULT_NAME,
) -> list[Stream]:
    """Divide the markers of a recording among sources in turn, so that every source observes every body.

    Parameters
    ----------
    recording
        The recording.
    split
        Number of sources; each gets every `split`-th marker.
    rates
        Hz, one for all sources or one for each, obtained by dropping frames. None: the k-th source
        has 1/k of the rate of the recording.
    source
        Name of the source; with several sources, the k-th is ``<source>-k``.

    Raises
    ------
    RecordingError
        If a rate is above that of the recording.
    ValueError
        If the number of rates is neither one nor the number of sources.
    """
    streams: list[Stream] = []
    for part in range(split):
        rate = recording.rate / (part + 1) if rates is None else rate_of(Part(part, split), rates)
        # The first source has every frame, however uneven the times are.
        instants = np.arange(len(recording))
        if rates is not None or part:
            # Tolerate nominal rates: 50 Hz may be recorded as 49.99 Hz.
            if rate > recording.rate * 1.01:
                raise RecordingError(
                    f"a rate of {rate:g} Hz exceeds the {recording.rate:.4g} Hz of the recording"
                )
            ticks = np.floor((recording.times - recording.times[0]) * rate + 1e-3)
            instants = np.flatnonzero(np.diff(ticks, prepend=-1.0) > 0)
        markers = np.arange(part, recording.positions.shape[1], split)
        both = np.ix_(instants, markers)
        stream = replace(
            recording,
            name=numbered(source, part, split),
            times=recording.times[instants],
            positions=recording.positions[both],
            labels=None if recording.labels is None else recording.labels[markers],
            sigma=None if recording.sigma is None else recording.sigma[both],
            ids=recording.ids[markers],
            rate=rate,
        )
        streams.append(stream)
    return streams


def read_recording(path: str | Path, fps: float | None = None, *, doubted: bool = True) -> Recording:
    """Read a recording, by its suffix: ``.c3d``, ``.npz``, ``.npy`` or ``.csv``.

    Parameters
    ----------
    path
        The file.
    fps
        Frames per second of tracks whose file has no times.
    doubted
        Log what is probably wrong with it.

    Raises
    ------
    RecordingError
        If the file is missing, truncated, empty or not a recording; one line that names the file.
    """
    from .c3d import read_c3d
    from .npz import read_npy, read_npz
    from .tracks import read_csv

    path = Path(path)
    readers = {".c3d": read_c3d, ".npz": read_npz, ".npy": read_npy, ".csv": read_csv}
    reader = readers.get(path.suffix.lower())
    try:
        if path.stat().st_size == 0:
            raise RecordingError("the file is empty")
        if reader is None:
            # A recorded scene has readers of its own; it is accepted wherever these are.
            raise RecordingError(f"its ending is not one of {', '.join((*readers, SUFFIX))}")
        recording = reader(path, fps)
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror or error}") from None
    except InputError as error:
        raise RecordingError(f"{path}: {error}") from None
    for text in doubts(recording.positions, recording.unit) if doubted else ():
        _log.warning("%s: %s", path, text)
    return recording
