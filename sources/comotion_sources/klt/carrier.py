"""Follows the link that carries a camera, by what another source publishes of it."""

import time
from typing import cast

import numpy as np

from comotion_schemas import ObservationBatch
from comotion_schemas.component import Component
from comotion_schemas.errors import KnownError
from comotion_schemas.types import is_name

from ..calibration.model import Extrinsics
from ..poses import PoseBuffer
from ..source import Inbox

_POLL_S = 0.004
MAX_LAG_S = 0.5
"""How long a frame waits for its pose: the default of the service's `max_lag`."""


def parse_carrier(text: str) -> tuple[str, int]:
    """Parse ``SOURCE:ID``, a 6-DoF feature of a source such as the link of a robot; the id is 0 if left out.

    Raises
    ------
    ValueError
        If it has not this form.
    """
    source, colon, feature = text.partition(":")
    if not is_name(source) or (colon and not feature.isdecimal()):
        raise KnownError(f"{text!r} is not SOURCE:ID, such as robot:3")
    return source, int(feature or 0)


class Carrier(PoseBuffer):
    """The poses of a camera by those of a feature that another source of the scene publishes.

    `mount` leads from the camera to the feature.
    """

    def __init__(self, component: Component, source: str, feature: int, mount: Extrinsics | None) -> None:
        super().__init__(mount)
        self._feature, self._stop = feature, component.stop
        self._batches = Inbox(component.session, component.keys.stream("obs", source), "obs")

    def at(self, stamp_ns: int) -> Extrinsics | None:
        """Pose at a stamp; waits until one as new has come, at most for :data:`MAX_LAG_S`."""
        end = time.monotonic() + MAX_LAG_S
        while True:
            for batch in self._batches.messages():
                add_poses(self, cast("ObservationBatch", batch), self._feature)
            newest = self.newest_ns
            if (newest is not None and newest >= stamp_ns) or time.monotonic() >= end:
                return super().at(stamp_ns)
            self._stop.wait(_POLL_S)


def add_poses(poses: PoseBuffer, batch: ObservationBatch, feature: int) -> None:
    """Add the poses of a feature in a batch to a buffer."""
    if batch.quaternions is None or batch.dim != 3:
        return
    rows = np.flatnonzero((batch.ids == feature) & np.isfinite(batch.quaternions[:, 0]))
    for row in rows.tolist():
        stamp = batch.stamp_ns if batch.stamps_ns is None else int(batch.stamps_ns[row])
        poses.add(
            stamp, Extrinsics.from_quaternion(batch.quaternions[row], batch.positions[row], batch.space)
        )
