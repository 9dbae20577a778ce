"""Fills `linked` of an update: the hypotheses of calibrated cameras that are bodies of a metric space."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import HypothesisUpdate

from ..partition import Partition
from ..rigid.method import MotionEngine
from ..rigid.poses import Poses
from ..space import Space
from .camera import Camera
from .links import decide, evidence, joined, speakers
from .reprojection import log_likelihoods
from .sightings import sight

# What moves has moved for seconds before it can be told: looking more often finds nothing sooner.
PERIOD_NS = 500_000_000
# Members per hypothesis that are asked.
_ASKED = 12

Partitions = Sequence[tuple[Space, Partition]]


class Linker:
    """Links between spaces, and their memory.

    Parameters
    ----------
    cameras
        Calibration by name of the camera's space.
    """

    def __init__(self, cameras: Mapping[str, Camera]) -> None:
        self._cameras = cameras
        self._links: dict[int, int] = {}
        self._due_ns: int | None = None

    def linked(self, update: HypothesisUpdate, partitions: Partitions) -> HypothesisUpdate:
        """Return the update with `linked` filled in, where there is something to say."""
        if not self._cameras:
            return update
        space = {h.id: h.space for h in update.hypotheses}
        self._links = {i: k for i, k in self._links.items() if self._possible(space.get(i), space.get(k))}
        if self._due_ns is None or update.stamp_ns >= self._due_ns:
            self._due_ns = update.stamp_ns + PERIOD_NS
            self._look(partitions)
        groups = joined(self._links, space)
        found = [replace(h, linked=groups[h.id]) if h.id in groups else h for h in update.hypotheses]
        return replace(update, hypotheses=found)

    def state(self) -> list[list[int]]:
        """Links as plain values."""
        return [[image, body] for image, body in self._links.items()]

    def load(self, state: Sequence[Sequence[int]]) -> None:
        """Take up :meth:`state`."""
        self._links = {int(image): int(body) for image, body in state}

    def _possible(self, image: str | None, body: str | None) -> bool:
        """Whether two spaces can be linked; what a snapshot brings may be of another calibration."""
        camera = self._cameras.get(image) if image is not None else None
        return camera is not None and camera.frame == body

    def _look(self, partitions: Partitions) -> None:
        bodies: dict[str, Poses | None] = {}
        for space, partition in partitions:
            camera = self._cameras.get(space.spec.name)
            if camera is None or space.spec.unit != "px" or space.spec.dim != 2:
                continue
            if camera.frame not in bodies:
                bodies[camera.frame] = _bodies(camera.frame, partitions)
            poses = bodies[camera.frame]
            if poses is not None:
                self._link(space, partition, poses, camera)

    def _link(self, space: Space, partition: Partition, poses: Poses, camera: Camera) -> None:
        """Decide anew for every hypothesis of one camera."""
        who = speakers(partition.labels, space.window.counts(space.current), _ASKED)
        sightings = sight(space.window, space.current[who], poses.stamps, camera)
        told, labels = log_likelihoods(sightings, poses, camera), partition.labels[who]
        clear = sightings.enough()
        for image in np.unique(labels).tolist():
            before = self._links.pop(image, None)
            column = _column(poses.ids, before)
            best = decide(evidence(told[clear & (labels == image)]), column)
            if best is not None and poses.ids[best] >= 0:
                self._links[image] = int(poses.ids[best])


def _bodies(name: str, partitions: Partitions) -> Poses | None:
    """Poses of the hypotheses that a metric space lists, and of the static body in any case."""
    for space, partition in partitions:
        if space.spec.name == name and isinstance(space.engine, MotionEngine) and space.spec.dim == 3:
            poses = space.engine.poses()
            if poses is None:
                return None
            listed = np.isin(poses.ids, [h.id for h in partition.hypotheses])
            listed[0] = True
            return poses.of(np.flatnonzero(listed))
    return None


def _column(ids: NDArray[np.int64], one: int | None) -> int | None:
    """Where a hypothesis is among the bodies."""
    known = ids.tolist()
    return known.index(one) if one in known else None
