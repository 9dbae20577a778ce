"""Groups whole trajectories offline: labels, hypotheses, poses and joints."""

from __future__ import annotations  # help() shows short types

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from comotion_schemas import UNDETERMINED, HypothesisUpdate, ObservationBatch
from comotion_schemas.errors import KnownError
from comotion_schemas.text import counted
from comotion_schemas.types import Unit

from ..arrays import Floats, Labels, last_true
from ..config import FusionConfig, to_ns
from ..event_time.entries import batch_of
from ..fusion import Fusion
from .compiling import compile_ahead
from .given import (
    DEFAULT,
    Parameters,
    checked,
    common_origin,
    config_of,
    longest_step_s,
    say_doubts,
    unit_of,
)
from .results import Grouping

# Updates in a time without data: so many after it begins, and as many before it ends.
_GAP_UPDATES = 10


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

        grouping = comotion.group(positions, times)
        grouping.labels  # int [T, N]
        grouping.plot("bodies.png")
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
        If positions look like millimetres, instants are too seldom, ids seem to change hands, or
        trajectories were refused.
    """
    given = positions if isinstance(positions, Mapping) else {DEFAULT: positions}
    clocks = times if isinstance(times, Mapping) else dict.fromkeys(given, times)
    if not given or clocks.keys() != given.keys():
        raise KnownError(f"positions are of {sorted(given)}, times of {sorted(clocks)}")
    used = config_of(config, parameters)
    step_s = longest_step_s(used)
    arrays = {name: checked(name, array, clocks[name], step_s) for name, array in given.items()}
    states = {name: array for name, (array, _) in arrays.items()}
    chosen = unit_of(unit, {array.shape[2] for array in states.values()})
    seconds = {name: clock for name, (_, clock) in arrays.items()}
    origin = common_origin(seconds)
    say_doubts(states, seconds, chosen, used.track_timeout)
    compile_ahead(used.method, chosen, max(array.shape[2] for array in states.values()))
    updates = list(_updates(_batches(arrays, chosen, origin), used))
    labels = {name: _labels(name, *arrays[name], origin, updates) for name in arrays}
    return Grouping(labels, updates, states, seconds, chosen)


def _batches(
    arrays: Mapping[str, tuple[Floats, Floats]], unit: Unit, origin: float
) -> list[ObservationBatch]:
    """All instants as batches, in time order; at equal times in the order of the sources."""
    batches = []
    for name, (states, times) in arrays.items():
        seen, ids = np.isfinite(states[..., 0]), np.arange(states.shape[1], dtype=np.uint64)
        # A feature ends after its last observation.
        last = np.where(seen.any(axis=0), last_true(seen.T), -2)
        for k, t in enumerate((times - origin).tolist()):
            ended, positions = ids[last == k - 1], states[k, seen[k]].astype(np.float32)
            others = {"stamp_ns": round(t * 1e9), "ids": ids[seen[k]], "ended": ended if ended.size else None}
            batches.append(batch_of(name, k, unit, positions, **others))
    return sorted(batches, key=lambda batch: batch.stamp_ns)


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
    fusion.timeline.faults.warn(stacklevel=4)
    if fusion.stats.refused_rows:
        warnings.warn(
            f"{counted(fusion.stats.refused_rows, 'observation')} refused, with the label -1: far "
            f"beyond all others, or of more than max_tracks={config.max_tracks} trajectories at once",
            stacklevel=4,
        )


def _labels(
    name: str, states: Floats, times: Floats, origin: float, updates: Sequence[HypothesisUpdate]
) -> Labels:
    """Label of each feature at each instant, from the first update that has fused it."""
    labels = np.full(states.shape[:2], -1, np.int64)
    stamps = [round(t * 1e9) for t in (times - origin).tolist()]
    # A faster source ends ahead of the last watermark: its last instants have the last labels.
    first = np.searchsorted([update.stamp_ns for update in updates[:-1]], stamps)
    for k in np.unique(first).tolist():
        known = updates[k].hypotheses_of(name, "0" * 16)
        found = [-1 if label == UNDETERMINED else label for label in known.values()]
        labels[np.ix_(first == k, list(known))] = found
    return np.where(np.isfinite(states[..., 0]), labels, -1)
