"""From when on bodies can be distinguished: two have moved against each other by five sigma."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from comotion_sources.simulator.actors import Poses

from .motion import Array
from .scene import Scene

SIGMAS = 5.0
_GRID_S = 0.05


@dataclass(frozen=True)
class Apart:
    """When each pair of bodies has moved apart: `since` float64 [B, B], s; infinite if never."""

    since: Array

    def components(self, t: float) -> NDArray[np.intp]:
        """Number the sets of bodies that nothing has separated until t, intp [B]."""
        groups: NDArray[np.intp] = connected_components(self.since > t, directed=False)[1].astype(np.intp)
        return groups

    @property
    def complete(self) -> float:
        """When every body is apart from every other, s; infinite if never."""
        others = ~np.eye(len(self.since), dtype=np.bool_)
        return float(self.since[others].max(initial=0.0))

    def onset(self, body: int) -> float:
        """When a body is apart from every other, s; infinite if never."""
        return float(np.delete(self.since[body], body).max(initial=0.0))


def apart(scene: Scene) -> Apart:
    """Find when the features of each pair of bodies have moved against each other.

    The measure is the root mean square over the features of one body of how far they have moved in the
    frame of the other since the scene's start; of the two ways round the smaller one.
    """
    times = np.arange(scene.start, scene.duration + _GRID_S, _GRID_S)
    poses = [body.motion(times) for body in scene.bodies]
    count = len(poses)
    since = np.full((count, count), np.inf)
    for i in range(count):
        for j in range(i):
            bound = SIGMAS * max(scene.bodies[i].sigma, scene.bodies[j].sigma)
            moved = np.minimum(_moved(scene, poses, i, j), _moved(scene, poses, j, i)) > bound
            if moved.any():
                since[i, j] = since[j, i] = times[int(moved.argmax())]
    return Apart(since)


def _moved(scene: Scene, poses: list[Poses], body: int, frame: int) -> Array:
    """Root mean square distance of a body's features from where they were in another's frame, [T]."""
    back = np.swapaxes(poses[frame].rotations, 1, 2)
    turn = back @ poses[body].rotations
    shift = np.einsum("tij,tj->ti", back, poses[body].translations - poses[frame].translations)
    # The first place of every slot of the body.
    mine = np.flatnonzero(scene.lives.body == body)
    _, first = np.unique(scene.lives.slot[mine], return_index=True)
    places = np.einsum("tij,nj->tni", turn, scene.lives.local[mine[first]]) + shift[:, None]
    return np.asarray(np.sqrt(((places - places[0]) ** 2).sum(axis=2).mean(axis=1)), np.float64)
