"""Packs the link poses of several instants into one batch. Pure: time is in the samples."""

from typing import Any, TypeAlias

import numpy as np

from .kinematics import Kinematics, LinkPoses
from .samples import JointSample

Columns: TypeAlias = dict[str, Any]
"""What a batch says, one row per instant and link, oldest first, by names of :class:`ObservationBatch`."""


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
    newest_ns
        Stamp of the newest sample that is packed; None before the first.
    """

    def __init__(self, kinematics: Kinematics, *, rate: float = 200.0, span: float = 0.02) -> None:
        self._kinematics = kinematics
        self._period_ns = round(1e9 / rate)
        self._span_ns = round(span * 1e9)
        self._pending: list[tuple[int, LinkPoses]] = []
        self.newest_ns: int | None = None
        self._due = 0

    def add(self, sample: JointSample) -> Columns | None:
        """Add a sample; returns a batch when one is full, else None.

        A sample that is not newer than the last one, or too many for the rate, is left out.

        Raises
        ------
        InputError
            If a joint is missing in the sample.
        """
        if self.newest_ns is not None and sample.stamp_ns <= self.newest_ns:
            return None
        # Tolerate jitter of a quarter of a period.
        if sample.stamp_ns < self._due - self._period_ns // 4:
            return None
        self._pending.append((sample.stamp_ns, self._kinematics.poses(sample)))
        self.newest_ns = sample.stamp_ns
        self._due = max(self._due + self._period_ns, sample.stamp_ns + self._period_ns // 2)
        full = sample.stamp_ns - self._pending[0][0] + 5 * self._period_ns // 4 >= self._span_ns
        return self.flush() if full else None

    def flush(self) -> Columns | None:
        """Return the pending instants as a batch; None if there are none."""
        pending, self._pending = self._pending, []
        if not pending:
            return None
        links = len(self._kinematics.links)
        stamps, poses = zip(*pending, strict=True)
        columns = LinkPoses(*map(np.concatenate, zip(*poses, strict=True)))._asdict()
        ids = np.tile(np.arange(links, dtype=np.uint64), len(pending))
        stamps_ns = np.repeat(np.array(stamps, np.int64), links)
        return columns | {"stamp_ns": stamps[-1], "ids": ids, "stamps_ns": stamps_ns}

    def restart(self) -> None:
        """Discard pending instants and the last stamp: the clock of the samples was set back."""
        self._pending, self.newest_ns, self._due = [], None, 0
