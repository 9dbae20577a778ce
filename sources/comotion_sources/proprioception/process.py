"""Proprioception as a process: joint readings in, 6-DoF poses of links out."""

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from comotion_schemas import DEFAULT_SCENE
from comotion_schemas.transport import SessionSettings

from ..runtime import SourcePublisher
from .inlets import Inlet
from .kinematics import Kinematics
from .packer import Pack, Packer, Packing
from .samples import JointSample, SampleError

_SET_BACK_NS = 1_000_000_000
_log = logging.getLogger(__name__)


def run(
    kinematics: Kinematics,
    inlet: Inlet,
    *,
    packing: Packing | None = None,
    truth: Mapping[str, tuple[int, str]] | None = None,
    name: str = "proprioception",
    space: str = "world",
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    ready_file: Path | None = None,
) -> None:
    """Publish the poses of links until the readings end or a signal stops it.

    Parameters
    ----------
    kinematics
        Robot and links.
    inlet
        Where the readings come from.
    packing
        Rate and batches.
    truth
        Object number and name of each link, where known (the workcell).
    name, space
        Of the source, and the coordinate space of its poses.
    scene, settings, ready_file
        As in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If scene or name is no valid chunk of a key, or a log turns out malformed.
    """
    packing = packing or Packing()
    source = SourcePublisher(
        name,
        space=space,
        unit="m",
        dim=3,
        scene=scene,
        settings=settings,
        ready_file=ready_file,
        rate=1.0 / max(packing.span, 1.0 / packing.rate),
        message=f"poses of {', '.join(kinematics.links)}",
    )
    with source:
        relay = _Relay(source, Packer(kinematics, packing))
        if truth is not None:
            _tell(source, kinematics, truth)
        source.ready()
        for sample in inlet.readings(source):
            relay.pass_on(sample)
        relay.pass_on(None)


class _Relay:
    """Moves readings through the packer to the wire, and counts what is refused."""

    def __init__(self, source: SourcePublisher, packer: Packer) -> None:
        self._source, self._packer = source, packer
        self._told: set[str] = set()
        self._newest = 0

    def pass_on(self, sample: JointSample | None) -> None:
        """Handle a reading, or None: nothing comes, send what waits."""
        if sample is None:
            self._publish(self._packer.flush())
            return
        if sample.stamp_ns < self._newest - _SET_BACK_NS:
            self._start_anew()
        self._newest = sample.stamp_ns
        stale = self._packer.stale
        try:
            pack = self._packer.add(sample)
        except SampleError as error:
            self._refuse(error)
            return
        if self._packer.stale > stale:
            self._source.count("late")
        self._publish(pack)

    def _start_anew(self) -> None:
        """The clock of the readings was set back (a simulation or log restarted)."""
        _log.warning("the stamps went back by more than a second: a new session begins")
        self._packer.restart()
        self._source.new_session()

    def _refuse(self, error: SampleError) -> None:
        self._source.reject("schema")
        if str(error) not in self._told:
            self._told.add(str(error))
            _log.warning("%s: such readings are left out", error)

    def _publish(self, pack: Pack | None) -> None:
        if pack is not None:
            self._source.observe(
                ids=pack.ids,
                positions=pack.positions,
                quaternions=pack.quaternions,
                sigma=pack.sigma,
                stamps_ns=pack.stamps_ns,
                stamp_ns=pack.stamp_ns,
            )


def _tell(source: SourcePublisher, kinematics: Kinematics, truth: Mapping[str, tuple[int, str]]) -> None:
    known = [(index, *truth[link]) for index, link in enumerate(kinematics.links) if link in truth]
    source.tell_truth(
        ids=np.array([index for index, _, _ in known], np.uint64),
        objects=[number for _, number, _ in known],
        names={number: name for _, number, name in known},
    )
