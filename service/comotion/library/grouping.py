"""Offline: whole trajectories in; a label per feature and instant, hypotheses, poses and joints out."""

from __future__ import annotations  # help() shows short types

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Joint, ObservationBatch
from comotion_schemas.errors import KnownError
from comotion_schemas.types import Unit

from ..arrays import Floats, Labels
from ..config import FusionConfig, to_ns
from ..fusion import Fusion
from .given import (
    DEFAULT,
    Parameters,
    checked,
    config_of,
    counted,
    longest_step_s,
    one_clock,
    say_doubts,
    unit_of,
)
from .plotting import draw

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

_SESSION = "0" * 16
# Updates in a time without data: so many after it begins, and as many before it ends.
_GAP_UPDATES = 10


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


@dataclass(frozen=True, eq=False, repr=False)
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
            If there are several sources; see :attr:`by_source`.
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

    def __repr__(self) -> str:
        shapes = ", ".join(f"{rows} x {columns}" for rows, columns in map(np.shape, self.by_source.values()))
        rest = sum(one.state == "static" for one in self.hypotheses)
        return f"Grouping({shapes}, {counted(self.hypotheses)}, {rest} at rest)"

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each feature and instant at which it was seen.

        Returns
        -------
        DataFrame
            Columns ``source``, ``time`` (s), ``feature``, ``hypothesis`` (-1: undetermined), and ``x``, ``y``
            and in space ``z``.

        Raises
        ------
        ModuleNotFoundError
            If pandas is not installed: ``pip install pandas``.
        """
        import pandas  # noqa: PLC0415 - no dependency of ours

        columns: dict[str, list[Any]] = {name: [] for name in ("source", "time", "feature", "hypothesis")}
        seen = {name: np.nonzero(np.isfinite(one[..., 0])) for name, one in self._positions.items()}
        for name, (rows, features) in seen.items():
            columns["source"] += [name] * len(rows)
            columns["time"].append(self._times[name][rows])
            columns["feature"].append(features)
            columns["hypothesis"].append(self.by_source[name][rows, features])
        places = np.concatenate([self._positions[name][at] for name, at in seen.items()])
        table = {name: one if name == "source" else np.concatenate(one) for name, one in columns.items()}
        return pandas.DataFrame(table | dict(zip("xyz", places.T, strict=False)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.labels, dtype=dtype, copy=copy)

    def plot(self, path: str | Path | None = None) -> Figure:
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
    config: FusionConfig | Mapping[str, Any] | None = None,
    **parameters: Unpack[Parameters],
) -> Grouping:
    """Group features into rigid bodies by how they move.

    ::

        found = comotion.group(positions, times)
        found.labels  # int [T, N]
        found.plot("bodies.png")
        comotion.group(positions, times, window=5)  # any parameter of FusionConfig

    The labels of an instant are those that were known then; nothing is taken from later ones. The clock is
    that of the data, so the same arrays give the same result.

    Parameters
    ----------
    positions
        float [T, N, 3] in metres, or [T, N, 2] in pixels (or metres, with ``unit="m"``); a row with NaN: not
        seen. Of several sources: by name, each with features of its own.
    times
        float [T], s, increasing, from any origin; datetime64, pandas times, and whole numbers of ms, us or
        ns are converted. Of several sources by name, or one for all.
    unit
        ``m`` or ``px``; None: m for three coordinates, px for two.
    config
        Parameters, as a :class:`FusionConfig` or a dict; the defaults when None.
    **parameters
        Single parameters by name, which replace those of `config`.

    Raises
    ------
    comotion.Error
        A ValueError. If shapes do not fit, times do not increase or are in no unit that is certain, a number
        is infinite, there is no observation, or a parameter is unknown or out of bounds.

    Warns
    -----
    UserWarning
        If positions look like millimetres, ids seem to change hands, or trajectories were refused.
    """
    given = positions if isinstance(positions, Mapping) else {DEFAULT: positions}
    clocks = times if isinstance(times, Mapping) else dict.fromkeys(given, times)
    if not given or clocks.keys() != given.keys():
        raise KnownError(f"positions are of {sorted(given)}, times of {sorted(clocks)}")
    used = config_of(config, parameters)
    step_s = longest_step_s(used)
    arrays = {name: checked(name, array, clocks[name], step_s) for name, array in given.items()}
    states = {name: array for name, (array, _) in arrays.items()}
    chosen = unit_of(unit, {one.shape[2] for one in states.values()})
    seconds = {name: clock for name, (_, clock) in arrays.items()}
    origin = one_clock(seconds)
    say_doubts(states, chosen)
    updates = list(_updates(_batches(arrays, chosen, origin), used))
    labels = {name: _labels(name, *arrays[name], origin, updates) for name in arrays}
    return Grouping(labels, updates, states, seconds, chosen)


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
        last = math.ceil((batch.stamp_ns - start_ns) / period_ns) - 1
        skipped = range(due + _GAP_UPDATES, last + 1 - _GAP_UPDATES)
        for number in range(due, last + 1):
            if number not in skipped:
                yield fusion.update(start_ns + number * period_ns)
        due = max(due, last + 1)
        fusion.ingest(batch)
    yield fusion.update(start_ns + due * period_ns)
    if fusion.stats.refused_rows:
        warnings.warn(
            f"{fusion.stats.refused_rows} observations were refused, and have the label -1: more than "
            f"max_tracks={config.max_tracks} trajectories at once",
            stacklevel=4,
        )


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
