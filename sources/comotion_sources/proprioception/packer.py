"""Joint samples -> batches with the link poses of several instants. Pure: time is in the samples."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .kinematics import Kinematics, LinkPoses
from .samples import JointSample


@dataclass(frozen=True, slots=True, eq=False)
class Pack:
    """The columns of one batch: one row per instant and link, oldest first.

    `ids` uint64 [N], the numbers of the links; `positions` [N, 3]; `quaternions` [N, 4]; `sigma` [N];
    `stamps_ns` int64 [N].
    """

    ids: np.ndarray
    positions: np.ndarray
    quaternions: np.ndarray
    sigma: np.ndarray
    stamps_ns: np.ndarray

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest instant."""
        return int(self.stamps_ns[-1])

    def columns(self) -> dict[str, Any]:
        """What it says of a batch, by the names of :class:`~comotion_schemas.ObservationBatch`."""
        return {"stamp_ns": self.stamp_ns} | {each.name: getattr(self, each.name) for each in fields(self)}


class Packer:
    """Groups joint samples into batches.

    Parameters
    ----------
    kinematics
        Robot and links.
    rate
        Most instants per second; further samples are left out.
    span
        Time covered by one batch, seconds.

    Attributes
    ----------
    stale
        Number of samples that were not newer than the one before.
    thinned
        Number of samples left out because of the rate.
    """

    def __init__(self, kinematics: Kinematics, *, rate: float = 200.0, span: float = 0.02) -> None:
        self._kinematics = kinematics
        self._period_ns = round(1e9 / rate)
        self._span_ns = round(span * 1e9)
        self._pending: list[tuple[int, LinkPoses]] = []
        self._newest: int | None = None
        self._due = 0
        self.stale = self.thinned = 0

    def add(self, sample: JointSample) -> Pack | None:
        """Add a sample; returns a batch when one is full, else None.

        Raises
        ------
        InputError
            If a joint is missing in the sample.
        """
        if self._newest is not None and sample.stamp_ns <= self._newest:
            self.stale += 1
            return None
        # Tolerate jitter of a quarter of a period.
        if sample.stamp_ns < self._due - self._period_ns // 4:
            self.thinned += 1
            return None
        self._pending.append((sample.stamp_ns, self._kinematics.poses(sample)))
        self._newest = sample.stamp_ns
        self._due = max(self._due + self._period_ns, sample.stamp_ns + self._period_ns // 2)
        full = sample.stamp_ns - self._pending[0][0] + 5 * self._period_ns // 4 >= self._span_ns
        return self.flush() if full else None

    def flush(self) -> Pack | None:
        """Return the pending instants as a batch; None if there are none."""
        pending, self._pending = self._pending, []
        if not pending:
            return None
        links = len(self._kinematics.links)
        return Pack(
            ids=np.tile(np.arange(links, dtype=np.uint64), len(pending)),
            positions=np.concatenate([poses.positions for _, poses in pending]),
            quaternions=np.concatenate([poses.quaternions for _, poses in pending]),
            sigma=np.concatenate([poses.sigma for _, poses in pending]),
            stamps_ns=np.repeat(np.array([stamp for stamp, _ in pending], np.int64), links),
        )

    def restart(self) -> None:
        """Discard pending instants and the last stamp: the clock of the samples was set back."""
        self._pending, self._newest, self._due = [], None, 0
