"""Groups features online, one instant at a time."""

from __future__ import annotations  # help() shows short types

import warnings
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, Self, Unpack

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ValidationError

from comotion_schemas import HypothesisUpdate
from comotion_schemas.doubts import coarse, other_unit
from comotion_schemas.errors import KnownError, describe
from comotion_schemas.rows import Rows, check_space, usable_rows
from comotion_schemas.text import counted
from comotion_schemas.time_units import instant, seconds
from comotion_schemas.types import Unit, is_name

from ..config import FusionConfig, to_ns
from ..event_time.entries import batch_of
from ..fusion import Fusion
from .compiling import compile_ahead
from .given import Parameters, config_of, longest_step_s

# First times of a source by which their unit is judged, and unread updates that are kept for an iteration.
_JUDGED, _MOST_UPDATES = 4, 100


class Scene:
    """Groups features online.

    ::

        scene = comotion.Scene(unit="m", window=5)
        update = scene.push(ids, positions, t)
        for hypothesis in update.hypotheses: ...

    Iteration yields the updates since the last iteration, at most the newest 100. As a context manager, the
    scene yields the update of its end, and takes nothing in afterwards.

    Parameters
    ----------
    unit
        Of the positions: ``m``, or ``px`` for features in an image.
    config
        Parameters, as a :class:`FusionConfig` or a dict; the defaults when None.
    drop_invalid
        Leave out rows with an infinite position or a negative id, and count them in :attr:`dropped`.
        Otherwise they are an error.
    **parameters
        Single parameters by name, which replace those of `config`.

    Attributes
    ----------
    fusion
        The core beneath.
    dropped
        Rows left out, by reason: ``non-finite``, ``range``.

    Raises
    ------
    comotion.Error
        A ValueError. If the unit is neither m nor px, or a parameter is unknown or out of bounds.
    """

    def __init__(
        self,
        unit: Unit = "m",
        config: FusionConfig | Mapping[str, Any] | None = None,
        *,
        drop_invalid: bool = False,
        **parameters: Unpack[Parameters],
    ) -> None:
        check_space(unit)
        self.fusion = Fusion(config_of(config, parameters))
        self.dropped: dict[str, int] = {}
        self._unit: Unit = unit
        self._dim: int | None = None
        self._drop_invalid = drop_invalid
        self._period_ns = to_ns(self.fusion.config.period)
        self._seq: dict[str, int] = {}
        self._newest: dict[str, int] = {}
        self._due_ns: int | None = None
        self._update: HypothesisUpdate | None = None
        self._first_times: dict[str, list[float]] = {}
        self._unread: deque[HypothesisUpdate] = deque(maxlen=_MOST_UPDATES)
        self._closed = False

    def __repr__(self) -> str:
        parts, update = [self._unit, counted(len(self._newest), "source")], self._update
        if update is not None:
            parts += [counted(len(update.track_id), "feature"), counted(len(update.hypotheses), "hypothesis")]
        return f"Scene({', '.join(parts)})"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *others: object) -> None:
        if self._newest and kind is None:
            self.update()
        self._closed = True

    def __iter__(self) -> Iterator[HypothesisUpdate]:
        while self._unread:
            yield self._unread.popleft()

    def push(
        self,
        ids: ArrayLike,
        positions: ArrayLike,
        t: float,
        source: str = "default",
        *,
        sigma: float | ArrayLike | None = None,
    ) -> HypothesisUpdate:
        """Take in what a source sees at one instant.

        Parameters
        ----------
        ids
            Integers [N] at or above 0, one per feature; never reused for another feature of the source.
        positions
            float [N, 3], or [N, 2] for images and planes, in the unit of the scene; a row with NaN: not seen.
        t
            s, or a datetime; when it was seen, from any origin that all sources share. Increasing per source.
        source
            Name of the source, ``[a-z0-9_-]{1,64}``. An update waits for the slowest source, at most
            ``max_lag`` of the parameters.
        sigma
            One-sigma noise of a position, a number or float [N]; None: it is estimated.

        Returns
        -------
        HypothesisUpdate
            The newest one: there is a new one every ``period`` of the parameters (0.1 s), and at the
            first push.

        Raises
        ------
        comotion.Error
            A ValueError. If arrays do not fit, an id is negative or used twice, `t` does not increase or is
            not in s, or the number of coordinates changes.
        """
        if self._closed:
            raise KnownError("the scene is closed; make a new one")
        stamp_ns = self._stamp(source, t)
        rows = usable_rows(ids, positions, {"sigma": sigma}, drop=self._drop_invalid)
        if source not in self._newest:
            for text in filter(None, (other_unit(rows.positions, self._unit), coarse(rows.positions))):
                warnings.warn(f"source {source!r}: {text}", stacklevel=2)
        try:
            self._ingest(source, stamp_ns, rows)
        except ValidationError as error:
            raise KnownError(describe(error)) from None
        for reason, count in rows.dropped.items():
            self.dropped[reason] = self.dropped.get(reason, 0) + count
        self._newest[source] = stamp_ns
        now = max(self._newest.values())
        if self._update is None or self._due_ns is None or now >= self._due_ns:
            return self.update(now / 1e9)
        return self._update

    def update(self, t: float | None = None) -> HypothesisUpdate:
        """Group now, whatever the period is.

        Parameters
        ----------
        t
            s; the time that is taken for now. None: that of the newest push.

        Raises
        ------
        ValueError
            If nothing has been pushed and no time is given.
        """
        if t is None and not self._newest:
            raise KnownError("nothing has been pushed")
        now = max(self._newest.values()) if t is None else round(instant(t) * 1e9)
        self._update = self.fusion.update(now)
        self.fusion.timeline.faults.warn(stacklevel=2)
        self._unread.append(self._update)
        self._due_ns = now + self._period_ns
        return self._update

    def _stamp(self, source: str, t: float) -> int:
        """Nanoseconds of a time, which is judged with the first ones of its source."""
        first = self._first_times.get(source, [])
        stamp_ns = round(instant(t) * 1e9)
        if stamp_ns <= (newest := self._newest.get(source, stamp_ns - 1)):
            times = f"the time {stamp_ns / 1e9:.9g} s does not increase: one of {newest / 1e9:.9g} s has come"
            raise KnownError(f"source {source!r}: {times}")
        if len(first) < _JUDGED:
            judged = [*first, stamp_ns / 1e9]
            if len(judged) == _JUDGED:
                seconds(judged, longest_step_s=longest_step_s(self.fusion.config))
            self._first_times[source] = judged
        return stamp_ns

    def _ingest(self, source: str, stamp_ns: int, rows: Rows) -> None:
        seq, positions = self._seq.get(source, 0), rows.positions
        if self._dim is None and len(positions):
            check_space(self._unit, positions.shape[1])
            self._dim = positions.shape[1]
            compile_ahead(self.fusion.config.method, self._unit, self._dim)
        dim = self._dim or (3 if self._unit == "m" else 2)
        if not len(positions):
            positions = np.zeros((0, dim), np.float32)
        elif positions.shape[1] != dim:
            raise KnownError(f"positions have {positions.shape[1]} coordinates, those before had {dim}")
        if not is_name(str(source)):
            raise KnownError(f"source {source!r} is not 1 to 64 characters of a-z, 0-9, _ and -")
        others = rows.columns | {"stamp_ns": stamp_ns, "ids": rows.ids}
        self.fusion.ingest(batch_of(source, seq, self._unit, positions, **others))
        self._seq[source] = seq + 1
