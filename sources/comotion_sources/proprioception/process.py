"""Publishes the links of a robot as 6-DoF features, the poses of several instants in one batch."""

import logging
from collections.abc import Mapping
from itertools import chain
from typing import Any, TypeAlias, Unpack

import numpy as np

from comotion_schemas.component import Where
from comotion_schemas.errors import InputError

from ..runtime import SourcePublisher
from .joints import JointSample, Reader
from .kinematics import Kinematics, LinkPoses

Columns: TypeAlias = dict[str, Any]
"""What a batch says, one row per instant and link, oldest first, by names of :class:`ObservationBatch`."""
_SET_BACK_NS = 1_000_000_000
"""Stamps that go back by more than this mean that the clock was reset, not that samples are late."""
_log = logging.getLogger(__name__)


class Packer:
    """Groups joint samples into batches.

    Further samples than `rate` instants per second are left out; a batch covers `span` s.

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


def run(
    kinematics: Kinematics,
    reader: Reader,
    *,
    rate: float = 200.0,
    span: float = 0.02,
    truth: Mapping[str, tuple[int, str]] | None = None,
    name: str = "proprioception",
    space: str = "world",
    **where: Unpack[Where],
) -> None:
    """Publish the poses of links until the samples end or a signal arrives.

    The samples come from `reader`; `rate` is in instants per second at most, `span` in s of instants in one
    batch. `truth` maps links to (object number, name), where known (the workcell); `name` is that of the
    source, `space` that of its poses.

    Raises
    ------
    ValueError
        If the log is malformed.
    """
    source = SourcePublisher(
        name,
        space=space,
        unit="m",
        dim=3,
        rate=1.0 / max(span, 1.0 / rate),
        message=f"poses of {', '.join(kinematics.links)}",
        feature_names=dict(enumerate(kinematics.links)),
        **where,
    )
    with source:
        if truth is not None:
            rows = [(index, *truth[link]) for index, link in enumerate(kinematics.links) if link in truth]
            source.tell_truth(
                ids=np.array([index for index, _, _ in rows], np.uint64),
                objects=[number for _, number, _ in rows],
                names={number: called for _, number, called in rows},
            )
        source.ready()
        packer = Packer(kinematics, rate=rate, span=span)
        for sample in chain(reader(source), [None]):
            if sample is not None and (newest_ns := packer.newest_ns) is not None:
                source.count("late", newest_ns - _SET_BACK_NS <= sample.stamp_ns <= newest_ns)
                if sample.stamp_ns < newest_ns - _SET_BACK_NS:  # a simulation or a log has begun again
                    _log.warning("the stamps went back by more than a second: a new session begins")
                    packer = Packer(kinematics, rate=rate, span=span)
                    source.new_session()
            columns = packer.flush() if sample is None else _packed(sample, packer, source)
            if columns is not None:
                source.observe(**columns)


def _packed(sample: JointSample, packer: Packer, source: SourcePublisher) -> Columns | None:
    """Add a sample to a batch; count one that lacks a joint."""
    try:
        return packer.add(sample)
    except InputError as error:
        source.reject("schema", str(error))
        return None
