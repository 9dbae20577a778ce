"""Online: positions of features at one instant in, the newest update out."""

import math

import numpy as np
from numpy.typing import ArrayLike

from comotion_schemas import HypothesisUpdate, ObservationBatch
from comotion_schemas.errors import KnownError
from comotion_schemas.rows import Rows, usable_rows
from comotion_schemas.types import Unit

from ..config import FusionConfig, to_ns
from ..fusion import Fusion

_SESSION = "0" * 16


class Scene:
    """Groups features online.

    ::

        scene = comotion.Scene(unit="m")
        update = scene.push(ids, positions, t)
        for hypothesis in update.hypotheses: ...

    Parameters
    ----------
    unit
        Of the positions: ``m``, or ``px`` for features in an image.
    config
        Parameters; the defaults when None.
    drop_invalid
        Leave out rows with a position that is not finite or a negative id, and count them in
        :attr:`dropped`. Otherwise a negative id is an error, and NaN means not seen.

    Attributes
    ----------
    fusion
        The core beneath.
    dropped
        Rows left out, by reason: ``non-finite``, ``range``.
    """

    def __init__(
        self, unit: Unit = "m", config: FusionConfig | None = None, *, drop_invalid: bool = False
    ) -> None:
        self.fusion = Fusion(config)
        self.dropped: dict[str, int] = {}
        self._unit: Unit = unit
        self._dim: int | None = None
        self._drop_invalid = drop_invalid
        self._period_ns = to_ns(self.fusion.config.period)
        self._seq: dict[str, int] = {}
        self._newest: dict[str, int] = {}
        self._due_ns: int | None = None
        self._update: HypothesisUpdate | None = None

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
            float [N, 3], or [N, 2] for images and planes, in the unit of the scene; a row of NaN: not seen.
        t
            s; when it was seen, from any origin that all sources share. Increasing per source.
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
        ValueError
            If arrays do not fit, an id is negative or used twice, `t` does not increase, or the number of
            coordinates changes.
        """
        if not math.isfinite(t):
            raise KnownError(f"the time {t} is not finite")
        stamp_ns = round(t * 1e9)
        if stamp_ns <= self._newest.get(source, stamp_ns - 1):
            raise KnownError(f"source {source!r}: the time {t:g} s does not increase")
        rows = usable_rows(ids, positions, sigma, unseen=True, drop=self._drop_invalid)
        for reason, count in rows.dropped.items():
            self.dropped[reason] = self.dropped.get(reason, 0) + count
        self._ingest(source, stamp_ns, rows)
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
        now = max(self._newest.values()) if t is None else round(t * 1e9)
        self._update = self.fusion.update(now)
        self._due_ns = now + self._period_ns
        return self._update

    def _ingest(self, source: str, stamp_ns: int, rows: Rows) -> None:
        seq = self._seq.get(source, 0)
        positions = rows.positions
        if self._dim is None and len(positions):
            self._dim = positions.shape[1]
        dim = self._dim or (3 if self._unit == "m" else 2)
        if not len(positions):
            positions = np.zeros((0, dim), np.float32)
        elif positions.shape[1] != dim:
            raise KnownError(f"positions have {positions.shape[1]} coordinates, those before had {dim}")
        batch = ObservationBatch(
            source=source,
            session=_SESSION,
            seq=seq,
            space="scene",
            unit=self._unit,
            dim=dim,
            stamp_ns=stamp_ns,
            ids=rows.ids,
            positions=positions,
            sigma=rows.sigma,
        )
        self.fusion.ingest(batch)
        self._seq[source] = seq + 1
