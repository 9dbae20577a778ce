"""Poses of the link that carries a camera: observations of another source -> pose buffer."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np
import zenoh

from comotion_schemas import DecodeError, Keys, ObservationBatch, decode_on
from comotion_schemas.errors import KnownError
from comotion_schemas.types import is_name

from ..calibration.model import Extrinsics
from ..poses import PoseBuffer

_RING = 1024
_POLL_S = 0.004
MAX_LAG_S = 0.5
"""How long a frame waits for its pose: the default of the service's `max_lag`."""


@dataclass(frozen=True)
class CarrierName:
    """A 6-DoF feature of a source: a link of a robot."""

    source: str
    feature: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse ``SOURCE:ID``; the id is 0 if it is left out.

        Raises
        ------
        ValueError
            If it has not this form.
        """
        source, colon, feature = text.partition(":")
        if not is_name(source) or (colon and not feature.isdecimal()):
            raise KnownError(f"{text!r} is not SOURCE:ID, such as robot:3")
        return cls(source, int(feature or 0))


class Carrier:
    """Fills a pose buffer from the observations of a source.

    Parameters
    ----------
    session, keys
        An open session, and the keys of the scene.
    name
        The feature that carries the camera.
    poses
        Gets its poses.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, name: CarrierName, poses: PoseBuffer) -> None:
        self._name, self._poses = name, poses
        key = keys.stream("obs", name.source)
        self._subscriber: Any = session.declare_subscriber(key, zenoh.handlers.RingChannel(_RING))
        self.invalid = 0

    def wait_for(self, stamp_ns: int, wait: Callable[[float], object]) -> None:
        """Take in poses until one is as new as a stamp, at most for :data:`MAX_LAG_S`."""
        end = time.monotonic() + MAX_LAG_S
        while True:
            self._drain()
            newest = self._poses.newest_ns
            if (newest is not None and newest >= stamp_ns) or time.monotonic() >= end:
                return
            wait(_POLL_S)

    def close(self) -> None:
        """Undeclare the subscription."""
        self._subscriber.undeclare()

    def _drain(self) -> None:
        while (sample := self._subscriber.try_recv()) is not None:
            try:
                self.add(cast("ObservationBatch", decode_on(str(sample.key_expr), sample.payload.to_bytes())))
            except DecodeError:
                self.invalid += 1

    def add(self, batch: ObservationBatch) -> None:
        """Take the poses of the carrier out of a batch."""
        if batch.quaternions is None or batch.dim != 3:
            return
        rows = np.flatnonzero((batch.ids == self._name.feature) & np.isfinite(batch.quaternions[:, 0]))
        for row in rows.tolist():
            stamp = batch.stamp_ns if batch.stamps_ns is None else int(batch.stamps_ns[row])
            pose = Extrinsics.from_quaternion(batch.quaternions[row], batch.positions[row], batch.space)
            self._poses.add(stamp, pose)
