"""Offline: whole trajectories in; a label per feature and instant, hypotheses, poses and joints out."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Joint, ObservationBatch
from comotion_schemas.errors import KnownError
from comotion_schemas.types import Unit

from ..arrays import Floats, Labels
from ..config import FusionConfig, to_ns
from ..fusion import Fusion
from .plotting import draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SESSION = "0" * 16
_DEFAULT = "default"
# No update changes in a longer time without data.
_LONGEST_GAP_NS = 600_000_000_000


@dataclass(frozen=True)
class Track:
    """The motion of one hypothesis over K updates.

    Attributes
    ----------
    times
        float64 [K], s, as the times that were given.
    centroid
        float64 [K, dim], mean position of the members.
    translation, rotation
        float64 [K, dim], and [K, 4] quaternions (x, y, z, w) or in 2-D angles [K] in rad: motion since
        birth, x(t) = R x(born) + translation. NaN where unknown: in pixels, and with the thesis method.
    """

    times: Floats
    centroid: Floats
    translation: Floats
    rotation: Floats


@dataclass(frozen=True, eq=False)
class Grouping:
    """What :func:`group` has found. In NumPy functions it stands for its :attr:`labels`.

    Attributes
    ----------
    by_source
        Labels of every source: int64 [T, N], the hypothesis of each feature as known at that instant, and
        -1 where it is undetermined or unseen.
    updates
        The updates of the core, in order; the last one is what is known at the end.
    """

    by_source: dict[str, Labels]
    updates: list[HypothesisUpdate]
    _positions: dict[str, Floats]
    _times: dict[str, Floats]
    _unit: Unit

    @property
    def labels(self) -> Labels:
        """Labels of the only source, int64 [T, N].

        Raises
        ------
        ValueError
            If there are several sources: see :attr:`by_source`.
        """
        if len(self.by_source) != 1:
            raise KnownError(f"there are {len(self.by_source)} sources: use by_source[name]")
        return next(iter(self.by_source.values()))

    @property
    def hypotheses(self) -> list[Hypothesis]:
        """The hypotheses at the end, with their poses, velocities and boxes."""
        return self.updates[-1].hypotheses

    @property
    def joints(self) -> list[Joint]:
        """The joints at the end."""
        return self.updates[-1].joints

    @property
    def poses(self) -> dict[int, Track]:
        """Motion of every hypothesis over time, by id."""
        origin = min(float(times[0]) for times in self._times.values())
        return dict(_tracks(self.updates, origin))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.labels, dtype=dtype, copy=copy)

    def plot(self, path: str | Path | None = None) -> "Figure":
        """Draw the trajectories in the colours of their hypotheses at the end.

        Parameters
        ----------
        path
            File to write; its suffix tells the format. None: none.

        Raises
        ------
        ModuleNotFoundError
            If matplotlib is not installed: ``pip install 'comotion[plot]'``.
        """
        figure = draw(self.updates, self._positions, self.by_source, self._unit)
        if path is not None:
            figure.savefig(path)
        return figure


def group(
    positions: ArrayLike | Mapping[str, ArrayLike],
    times: ArrayLike | Mapping[str, ArrayLike],
    *,
    unit: Unit | None = None,
    config: FusionConfig | None = None,
) -> Grouping:
    """Group features into rigid bodies by how they move.

    ::

        found = comotion.group(positions, times)
        found.labels  # int [T, N]
        found.plot("bodies.png")

    The labels of an instant are those that were known then; nothing is taken from later ones. The clock is
    that of the data, so the same arrays give the same result.

    Parameters
    ----------
    positions
        float [T, N, 3] in metres, or [T, N, 2] in pixels (or metres, with ``unit="m"``); a row of NaN: not
        seen. Of several sources: by name, each with features of its own.
    times
        float [T], s, increasing, from any origin; of several sources by name, or one for all.
    unit
        ``m`` or ``px``; None: m for three coordinates, px for two.
    config
        Parameters; the defaults when None.

    Raises
    ------
    ValueError
        If shapes do not fit, times do not increase, a number is infinite, or there is no observation.
    """
    given = positions if isinstance(positions, Mapping) else {_DEFAULT: positions}
    clocks = times if isinstance(times, Mapping) else dict.fromkeys(given, times)
    if clocks.keys() != given.keys():
        raise KnownError(f"positions are of {sorted(given)}, times of {sorted(clocks)}")
    arrays = {name: _checked(name, array, clocks[name]) for name, array in given.items()}
    dims = {states.shape[2] for states, _ in arrays.values()}
    if len(dims) != 1:
        raise KnownError("sources differ in their number of coordinates")
    chosen: Unit = unit or ("m" if dims == {3} else "px")
    origin = min(float(clock[0]) for _, clock in arrays.values())
    config = config or FusionConfig()
    updates = list(_updates(_batches(arrays, chosen, origin), config))
    labels = {name: _labels(name, *arrays[name], origin, updates) for name in arrays}
    states = {name: array for name, (array, _) in arrays.items()}
    return Grouping(labels, updates, states, {name: clock for name, (_, clock) in arrays.items()}, chosen)


def _checked(name: str, positions: ArrayLike, times: ArrayLike) -> tuple[Floats, Floats]:
    """Positions float64 [T, N, dim] with rows of NaN where unseen, and times float64 [T]."""
    states, clock = np.array(positions, np.float64), np.asarray(times, np.float64)
    who = "" if name == _DEFAULT else f"source {name!r}: "
    if states.ndim != 3 or states.shape[2] not in {2, 3}:
        raise KnownError(f"{who}positions have the shape {states.shape}, not [T, N, 3] or [T, N, 2]")
    if clock.shape != states.shape[:1]:
        raise KnownError(f"{who}there are {clock.shape} times for {len(states)} instants")
    if not np.isfinite(clock).all() or not (np.diff(clock) > 0).all():
        raise KnownError(f"{who}times do not increase")
    if np.isinf(states).any():
        raise KnownError(f"{who}a position is infinite; NaN stands for unseen")
    states[np.isnan(states).any(axis=2)] = np.nan
    if not np.isfinite(states).any():
        raise KnownError(f"{who}there is no observation")
    return states, clock


def _batches(
    arrays: Mapping[str, tuple[Floats, Floats]], unit: Unit, origin: float
) -> list[ObservationBatch]:
    """All instants as batches, in time order; at equal times in the order of the sources."""
    return sorted(
        (batch for name, one in arrays.items() for batch in _of_source(name, *one, unit, origin)),
        key=lambda batch: batch.stamp_ns,
    )


def _of_source(
    name: str, states: Floats, times: Floats, unit: Unit, origin: float
) -> Iterator[ObservationBatch]:
    seen = np.isfinite(states[..., 0])
    ids = np.arange(states.shape[1], dtype=np.uint64)
    # A feature ends after its last observation.
    last = np.where(seen.any(axis=0), len(states) - 1 - np.argmax(seen[::-1], axis=0), -2)
    for k, t in enumerate((times - origin).tolist()):
        ended = ids[last == k - 1]
        yield ObservationBatch(
            source=name,
            session=_SESSION,
            seq=k,
            space="scene",
            unit=unit,
            dim=states.shape[2],
            stamp_ns=round(t * 1e9),
            ids=ids[seen[k]],
            positions=states[k, seen[k]].astype(np.float32),
            ended=ended if ended.size else None,
        )


def _updates(batches: Sequence[ObservationBatch], config: FusionConfig) -> Iterator[HypothesisUpdate]:
    """Yield an update every period after the first instant, the last one after the last instant."""
    fusion, period_ns = Fusion(config), to_ns(config.period)
    start_ns, due = batches[0].stamp_ns, 1
    for batch in batches:
        due = max(due, math.ceil((batch.stamp_ns - _LONGEST_GAP_NS - start_ns) / period_ns))
        while batch.stamp_ns > start_ns + due * period_ns:
            yield fusion.update(start_ns + due * period_ns)
            due += 1
        fusion.ingest(batch)
    yield fusion.update(start_ns + due * period_ns)


def _labels(
    name: str, states: Floats, times: Floats, origin: float, updates: Sequence[HypothesisUpdate]
) -> Labels:
    """Label of each feature at each instant, from the first update that has fused it."""
    seen = np.isfinite(states[..., 0])
    found = np.full(seen.shape, -1, np.int64)
    stamps = np.array([round(t * 1e9) for t in (times - origin).tolist()])
    last_ns = -1
    for update in updates:
        # A faster source ends ahead of the last watermark: its last instants have the last labels.
        until_ns = stamps[-1] if update is updates[-1] else update.stamp_ns
        rows = np.flatnonzero((stamps <= until_ns) & (stamps > last_ns))
        last_ns = update.stamp_ns
        if len(rows):
            now = np.full(states.shape[1], -1, np.int64)
            mine = np.array([ref.name == name for ref in update.sources], bool)[update.track_source]
            labels = update.track_hypothesis[mine].astype(np.int64)
            now[update.track_id[mine].astype(np.intp)] = np.where(labels == UNDETERMINED, -1, labels)
            found[rows] = np.where(seen[rows], now, -1)
    return found


def _tracks(updates: Sequence[HypothesisUpdate], origin: float) -> Iterator[tuple[int, Track]]:
    rows: dict[int, list[tuple[int, Hypothesis]]] = {}
    for update in updates:
        for one in update.hypotheses:
            if not one.absent:
                rows.setdefault(one.id, []).append((update.stamp_ns, one))
    for number, seen in rows.items():
        dim = len(seen[0][1].centroid)
        none = [math.nan] * 4 if dim == 3 else math.nan
        yield (
            number,
            Track(
                np.array([origin + stamp / 1e9 for stamp, _ in seen]),
                np.array([h.centroid for _, h in seen]),
                np.array([h.pose.translation if h.pose else [math.nan] * dim for _, h in seen]),
                np.array([h.pose.rotation if h.pose else none for _, h in seen]),
            ),
        )
