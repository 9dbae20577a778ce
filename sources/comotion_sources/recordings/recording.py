"""What every reader of recordings gives, and how its markers become the streams of sources."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import RecordingError
from comotion_schemas.types import Unit

from ..streams import Frame, Part, Stream, numbered, rate_of

DEFAULT_NAME = "replay"


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """The content of a recording.

    Attributes
    ----------
    name
        Name of the file without its suffix.
    times
        float64 [F], seconds, increasing, the first is 0.
    positions
        float64 [F, N, dim] in `unit`, rows of NaN where unobserved.
    labels
        int64 [N], number of the true object, -1 for ambiguous; None without truth.
    label_names
        Names of the objects by number.
    sigma
        float64 [F, N], one-sigma noise of a position in `unit`, above 0 where observed; None: unknown.
    ids
        uint64 [N], ids of the features; None: their numbers.
    space, unit, dim
        Coordinate space: ``world`` in m for 3-D, ``pixels`` in px for 2-D.
    """

    name: str
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    labels: NDArray[np.int64] | None
    label_names: dict[int, str]
    sigma: NDArray[np.float64] | None = None
    ids: NDArray[np.uint64] | None = None

    @property
    def dim(self) -> int:
        """2 or 3."""
        return int(self.positions.shape[2])

    @property
    def unit(self) -> Unit:
        """``px`` in 2-D, ``m`` in 3-D."""
        return "px" if self.dim == 2 else "m"

    @property
    def space(self) -> str:
        """Name of the coordinate space."""
        return "pixels" if self.dim == 2 else "world"

    @property
    def rate(self) -> float:
        """Instants per second, from the median interval."""
        return 1.0 / self.period

    @property
    def period(self) -> float:
        """Median interval between two instants, seconds."""
        return float(np.median(np.diff(self.times)))

    @property
    def length(self) -> float:
        """Seconds after which the recording may be repeated: time of the last instant plus one period."""
        return float(self.times[-1]) + self.period

    def __len__(self) -> int:
        return len(self.times)

    def __post_init__(self) -> None:
        if len(self.times) < 2:
            raise RecordingError("it holds fewer than two instants")
        if not (np.diff(self.times) > 0).all():
            raise RecordingError("its times do not increase")
        if not np.isfinite(self.positions).any():
            raise RecordingError("it holds no observation")


class RecordedStream(Stream):
    """The frames of some markers of a recording at some of its instants; may be iterated repeatedly.

    The id of a feature is that of the recording, else the number of its marker. A feature ends with its last
    observation.

    Parameters
    ----------
    recording, name, rate
        The recording, name of the source, and frames per second.
    markers
        intp [M], numbers of the markers.
    instants
        intp [K], numbers of the instants.
    """

    publish_sigma = True

    def __init__(
        self,
        recording: Recording,
        name: str,
        rate: float,
        markers: NDArray[np.intp],
        instants: NDArray[np.intp],
    ) -> None:
        self.name, self.rate, self.length = name, rate, recording.length
        self.space, self.unit, self.dim = recording.space, recording.unit, recording.dim
        self.objects = recording.label_names
        self._times = recording.times[instants]
        self._positions = recording.positions[np.ix_(instants, markers)]
        self._seen: NDArray[np.bool_] = np.isfinite(self._positions[..., 0])
        self._ids = (markers if recording.ids is None else recording.ids[markers]).astype(np.uint64)
        self._sigma = None if recording.sigma is None else recording.sigma[np.ix_(instants, markers)]
        labels = recording.labels
        self._labels = None if labels is None else labels[markers].astype(np.int32)
        # Index of the last observation; -2 where there is none, so that the feature never ends.
        last = len(instants) - 1 - np.argmax(self._seen[::-1], axis=0)
        self._last = np.where(self._seen.any(axis=0), last, -2)

    def __len__(self) -> int:
        return len(self._times)

    def __iter__(self) -> Iterator[Frame]:
        for k, t in enumerate(self._times.tolist()):
            seen = self._seen[k]
            yield Frame(
                t=t,
                ids=self._ids[seen],
                positions=self._positions[k, seen],
                objects=None if self._labels is None else self._labels[seen],
                ended=self._ids[self._last == k - 1],
                sigma=None if self._sigma is None else self._sigma[k, seen],
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
        streams.append(RecordedStream(recording, numbered(source, part, split), rate, markers, instants))
    return streams
