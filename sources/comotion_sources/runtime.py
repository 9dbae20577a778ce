"""Publishes the observations of one source, as programs have them."""

from __future__ import annotations  # help() shows short types

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from comotion_schemas import DEFAULT_SCENE, ObservationBatch, TruthBatch, encode
from comotion_schemas.component import new_session_id
from comotion_schemas.doubts import coarse
from comotion_schemas.errors import KnownError, one_line_errors
from comotion_schemas.messages import RejectionReason
from comotion_schemas.rows import check_space, usable_rows
from comotion_schemas.transport import SessionSettings, client_settings
from comotion_schemas.types import Unit

from .source import Source
from .streams import MessageBuilder

_log = logging.getLogger(__name__)


class SourcePublisher(Source):
    """Publishes one source until its :attr:`stop` is set, by a signal or otherwise.

    ::

        with SourcePublisher("my-tracker", space="world", unit="m", dim=3) as source:
            source.ready()
            while not source.stop.is_set():
                ids, positions = my_tracker.next_frame()
                source.observe(ids=ids, positions=positions)

    Parameters
    ----------
    name
        Name of the source, one chunk of ``[a-z0-9_-]{1,64}``.
    space, unit, dim
        The coordinate space of the positions.
    scene
        Name of the scene.
    connect
        Endpoint of the router, or several, as in ``comotion_clients.subscribe``; None: that of this machine.
    settings
        Where to connect, and with what certificate, instead of `connect` and `tls`.
    tls
        Without `settings`: the folder that ``comotion pki issue`` has written; None: the folder named by
        ``COMOTION_TLS`` in the environment, if there is one.
    drop_invalid
        Leave out rows with an infinite position (``non-finite``) or a negative id (``range``) and
        count them in :attr:`dropped` and in Status. Otherwise such a row is an error.
    ready_file
        Written by :meth:`ready` instead of the line ``ready`` on standard output.
    rate
        Nominal rate in Hz, for detecting a stall; 0: unknown.
    message
        One line for Status that describes the source.
    feature_names
        Names of features by id, as of the links of a robot; what they move with is called by them.
    moving
        Whether the frame of the space is carried, as that of a camera in the hand.

    Raises
    ------
    ValueError
        If the name of the scene or source is not valid, or the unit does not go with `dim`.
    """

    def __init__(
        self,
        name: str,
        *,
        space: str,
        unit: Unit,
        dim: int,
        scene: str = DEFAULT_SCENE,
        connect: str | Sequence[str] | None = None,
        settings: SessionSettings | None = None,
        tls: Path | str | None = None,
        drop_invalid: bool = False,
        ready_file: Path | None = None,
        rate: float = 0.0,
        message: str = "",
        feature_names: Mapping[int, str] | None = None,
        moving: bool = False,
    ) -> None:
        if connect is not None and settings is not None:
            raise KnownError("give connect or settings, not both")
        check_space(unit, dim)
        super().__init__(
            name,
            rate=rate,
            message=message,
            feature_names=feature_names,
            scene=scene,
            settings=settings or client_settings(connect, tls),
            ready_file=ready_file,
        )
        self._drop_invalid = drop_invalid
        # Whether the first positions were looked at.
        self._judged = False
        self.builder = MessageBuilder(
            source=name, session=self.session_id, space=space, unit=unit, dim=dim, moving=moving
        )

    @property
    def dropped(self) -> dict[RejectionReason, int]:
        """Rows that were left out, by reason."""
        return dict(self._rejected)

    def new_session(self) -> None:
        """Start a new session: all trajectories end, and ids and sequence numbers start again."""
        self._begin_session(new_session_id())
        self.builder = replace(self.builder, session=self.session_id)

    def observe(
        self,
        *,
        ids: ArrayLike,
        positions: ArrayLike,
        stamp_ns: int | None = None,
        sigma: float | ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        quaternions: ArrayLike | None = None,
        ended: ArrayLike | None = None,
        stamps_ns: ArrayLike | None = None,
    ) -> None:
        """Publish the observations of one instant, or of several with `stamps_ns`.

        Parameters
        ----------
        ids
            Integers [N] at or above 0; an id must never be reused for another feature.
        positions
            float [N, dim], in the unit of the source; a row with NaN: not seen. Infinite: see `drop_invalid`.
        stamp_ns
            Acquisition time, nanoseconds since the Unix epoch; None: now.
        sigma
            One-sigma noise of a position in the unit of the source, a number or float [N]; None: unknown.
        covariance
            Float [N, 6] (xx, xy, xz, yy, yz, zz), in 2-D [N, 3] (xx, xy, yy), m²: covariance of the noise of
            a position in the axes of the space, as of a depth camera with known rays; it takes
            precedence over `sigma`.
        quaternions
            float [N, 4] (x, y, z, w) of 6-DoF features, rows of NaN for points; None: only points.
        ended
            Ids [M] that the source has lost for good.
        stamps_ns
            Acquisition time of each row, int64 [N], if they differ; the largest equals `stamp_ns`.

        Raises
        ------
        comotion.Error
            A ValueError. If the arrays are malformed; nothing is published then.
        """
        with one_line_errors():
            columns = {"sigma": sigma, "covariance": covariance, "quaternions": quaternions}
            columns["stamps_ns"] = stamps_ns
            instants = stamps_ns is not None
            rows = usable_rows(ids, positions, columns, drop=self._drop_invalid, instants=instants)
            if not self._judged and len(rows.ids):
                self._judged = True
                if text := coarse(rows.positions):
                    _log.warning("%s", text)
            for reason, count in rows.dropped.items():
                self.reject(reason, count=count)
            stamp = time.time_ns() if stamp_ns is None else stamp_ns
            if instants and 0 < len(rows.ids) < np.size(ids):
                stamp = int(rows.columns["stamps_ns"].max())
            positions = rows.positions if len(rows.ids) else np.zeros((0, self.builder.dim))
            batch = self.builder.observation(
                stamp_ns=stamp, ids=rows.ids, positions=positions, ended=ended, **rows.columns
            )
            self.put(batch)

    def tell_truth(self, *, ids: ArrayLike, objects: ArrayLike, names: Mapping[int, str]) -> None:
        """Publish the true objects of features.

        Parameters
        ----------
        ids
            Unsigned integers [N].
        objects
            Integers [N], object numbers, -1 for ambiguous.
        names
            Object number -> name.

        Raises
        ------
        pydantic.ValidationError
            If the arrays are malformed.
        """
        self.put(self.builder.truth(ids=ids, objects=objects, names=names))

    def put(self, message: ObservationBatch | TruthBatch) -> None:
        """Publish a message that :attr:`builder` has built."""
        self.send("truth" if isinstance(message, TruthBatch) else "obs", encode(message), message)
