"""A recording: the positions of every marker or track at every instant, with the truth if known."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.types import Unit

from ..errors import RecordingError
from ..frames import AMBIGUOUS, Frame


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """What a file holds.

    Attributes
    ----------
    name
        Name of the file without its ending.
    times
        float64 [F], seconds, increasing, the first is 0.
    positions
        float64 [F, N, dim] in `unit`, rows of NaN where unobserved.
    labels
        int64 [N], number of the true object, -1 for ambiguous; None without truth.
    label_names
        Names of the objects by number.
    space, unit, dim
        Coordinate space: ``world`` in m for 3-D, ``pixels`` in px for 2-D.
    """

    name: str
    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    labels: NDArray[np.int64] | None
    label_names: dict[int, str]

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
        """Hz, from the median interval."""
        return 1.0 / self.period

    @property
    def period(self) -> float:
        """Median interval between two instants, seconds."""
        return float(np.median(np.diff(self.times)))

    @property
    def length(self) -> float:
        """Seconds after which the recording may be repeated: to the last instant and one period more."""
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


def thin(times: NDArray[np.float64], rate: float | None) -> NDArray[np.intp]:
    """Choose the frames that remain when a recording is brought down to a rate (Hz) by dropping.

    The first frame that reaches each multiple of the period is kept; without a rate all are.

    Raises
    ------
    RecordingError
        If the rate is above that of the recording.
    """
    if rate is None:
        return np.arange(len(times))
    native = 1.0 / float(np.median(np.diff(times)))
    # A nominal 50 Hz may be recorded as 49.99.
    if rate > native * 1.01:
        raise RecordingError(f"a rate of {rate:g} Hz exceeds the {native:.4g} Hz of the recording")
    ticks = np.floor((times - times[0]) * rate + 1e-3)
    return np.flatnonzero(np.diff(ticks, prepend=-1.0) > 0)


class RecordedFrames:
    """The frames of some markers of a recording at some of its instants; iterated anew each time.

    A marker's id is its number in the recording. It ends with its last observation.

    Parameters
    ----------
    recording
        Where from.
    markers
        intp [M], the markers.
    instants
        intp [K], the frames.
    time_scale
        Factor on the times.
    """

    def __init__(
        self,
        recording: Recording,
        *,
        markers: NDArray[np.intp],
        instants: NDArray[np.intp],
        time_scale: float = 1.0,
    ) -> None:
        self._times = recording.times[instants] * time_scale
        self._positions = recording.positions[np.ix_(instants, markers)]
        self._seen: NDArray[np.bool_] = np.isfinite(self._positions[..., 0])
        self._ids = markers.astype(np.uint64)
        labels = recording.labels
        self._objects = None if labels is None else labels[markers].astype(np.int32)
        # Where the last observation is; -1 where there is none.
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
                objects=None if self._objects is None else self._objects[seen],
                ended=self._ids[self._last == k - 1],
            )


def clean(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make every row that is not wholly finite, or beyond float32, a row of NaN."""
    limit = np.finfo(np.float32).max
    with np.errstate(invalid="ignore"):
        known: NDArray[np.bool_] = np.all(np.abs(positions) <= limit, axis=2)
    return np.where(known[..., None], positions, np.nan)


def clean_labels(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Objects are numbered from 1; what recordings say with 0 and below (outlier, joint) is ambiguous."""
    return np.where(labels >= 1, labels, AMBIGUOUS)


def divide(count: int, parts: int) -> Sequence[NDArray[np.intp]]:
    """Deal markers out to sources in turn, so that every source sees every body."""
    return [np.arange(part, count, parts) for part in range(parts)]
