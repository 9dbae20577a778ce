"""Publishes the links of a robot as 6-DoF features."""

import logging
from collections.abc import Mapping
from itertools import chain
from typing import Unpack

import numpy as np

from comotion_schemas.component import Where

from ..errors import InputError
from ..runtime import SourcePublisher
from .joint_readers import Reader
from .kinematics import Kinematics
from .packer import Columns, Packer
from .samples import JointSample

_SET_BACK_NS = 1_000_000_000
"""Stamps that go back by more than this mean that the clock was reset, not that samples are late."""
_log = logging.getLogger(__name__)


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

    Parameters
    ----------
    kinematics
        Robot and links.
    reader
        Where the joint samples come from.
    rate, span
        Most instants per second, and s of instants in one batch.
    truth
        Link -> (object number, name), where known (the workcell).
    name, space
        Name of the source; coordinate space of its poses.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If the name of the scene or source is not valid, or the log is malformed.
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
            known = [(index, *truth[link]) for index, link in enumerate(kinematics.links) if link in truth]
            source.tell_truth(
                ids=np.array([index for index, _, _ in known], np.uint64),
                objects=[number for _, number, _ in known],
                names={number: called for _, number, called in known},
            )
        source.ready()
        packer = Packer(kinematics, rate=rate, span=span)
        for sample in chain(reader(source), [None]):
            columns = packer.flush() if sample is None else _packed(sample, packer, source)
            if columns is not None:
                source.observe(**columns)


def _packed(sample: JointSample, packer: Packer, source: SourcePublisher) -> Columns | None:
    """Add a sample to a batch; count one that is late or lacks a joint."""
    if packer.newest_ns is not None and sample.stamp_ns < packer.newest_ns - _SET_BACK_NS:
        # A simulation or a log has begun again.
        _log.warning("the stamps went back by more than a second: a new session begins")
        packer.restart()
        source.new_session()
    source.count("late", packer.newest_ns is not None and sample.stamp_ns <= packer.newest_ns)
    try:
        return packer.add(sample)
    except InputError as error:
        source.reject("schema", str(error))
        return None
