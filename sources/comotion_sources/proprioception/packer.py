"""Poses of several instants packed into batches. Pure: time comes with the samples."""

from dataclasses import dataclass

import numpy as np

from .kinematics import Kinematics, LinkPoses
from .samples import JointSample


@dataclass(frozen=True, kw_only=True)
class Packing:
    """How readings become batches.

    Attributes
    ----------
    rate
        Hz; most instants per second, others are thinned out.
    span
        Seconds of instants in one batch.
    """

    rate: float = 200.0
    span: float = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Pack:
    """The columns of one batch: rows are instants times links, oldest first.

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


class Packer:
    """Turns readings into batches.

    Attributes
    ----------
    stale
        Readings that were not newer than the one before.
    thinned
        Readings left out because of the rate.
    """

    def __init__(self, kinematics: Kinematics, packing: Packing | None = None) -> None:
        self._kinematics = kinematics
        packing = packing or Packing()
        self._period_ns = round(1e9 / packing.rate)
        self._span_ns = round(packing.span * 1e9)
        self._waiting: list[tuple[int, LinkPoses]] = []
        self._newest: int | None = None
        self._due = 0
        self.stale = self.thinned = 0

    def add(self, sample: JointSample) -> Pack | None:
        """Take in a reading; answers with a batch when one is full.

        Raises
        ------
        SampleError
            If the reading lacks a joint.
        """
        if self._newest is not None and sample.stamp_ns <= self._newest:
            self.stale += 1
            return None
        # A reading that the jitter of a clock brings a little early is still of the wanted rate.
        if sample.stamp_ns < self._due - self._period_ns // 4:
            self.thinned += 1
            return None
        self._waiting.append((sample.stamp_ns, self._kinematics.poses(sample)))
        self._newest = sample.stamp_ns
        self._due = max(self._due + self._period_ns, sample.stamp_ns + self._period_ns // 2)
        full = sample.stamp_ns - self._waiting[0][0] + 5 * self._period_ns // 4 >= self._span_ns
        return self.flush() if full else None

    def flush(self) -> Pack | None:
        """Answer with what waits, None when nothing does."""
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return None
        links = len(self._kinematics.links)
        return Pack(
            ids=np.tile(np.arange(links, dtype=np.uint64), len(waiting)),
            positions=np.concatenate([poses.positions for _, poses in waiting]),
            quaternions=np.concatenate([poses.quaternions for _, poses in waiting]),
            sigma=np.concatenate([poses.sigma for _, poses in waiting]),
            stamps_ns=np.repeat(np.array([stamp for stamp, _ in waiting], np.int64), links),
        )

    def restart(self) -> None:
        """Forget the last stamp: the clock of the readings has been set back."""
        self._waiting, self._newest, self._due = [], None, 0
