"""Surface coverage: features -> share of the surface of the true objects within their reach."""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comotion_sources.workcell import Scene
from comotion_sources.workcell.scene import MOVING

Points = NDArray[np.float64]

REACH_M = 0.03
"""A point of the surface is covered by a feature of its object this near."""
_SPACING_M = 0.015


class Surfaces:
    """Sample points on the moving objects of a scene, in the frames of their bodies.

    Parameters
    ----------
    scene
        The scene; objects that are not scored are left out.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene, self._data = scene, scene.new_data()

    @cached_property
    def objects(self) -> dict[int, Points]:
        """Sample points float64 [P, 3] of each moving object, in the frame of its own body."""
        scene, found = self._scene, dict[int, list[Points]]()
        scene.place(self._data, scene.configuration(0.0))
        for geom in np.flatnonzero(scene.model.geom_group == MOVING):
            number = int(scene.geom_objects[geom])
            if number > 0:
                found.setdefault(number, []).append(self._in_body(number, self._world_points(int(geom))))
        return {number: np.concatenate(parts) for number, parts in sorted(found.items())}

    def covered(self, t: float, positions: Points, objects: NDArray[np.integer]) -> dict[int, float]:
        """Share of each object's surface that is within reach of a feature of it.

        Parameters
        ----------
        t
            Time in the scene, seconds.
        positions
            Features [N, 3] in the world.
        objects
            True object of each feature, int [N].
        """
        self._scene.place(self._data, self._scene.configuration(t))
        shares = {}
        for number, points in self.objects.items():
            own = positions[objects == number]
            if not len(own):
                shares[number] = 0.0
                continue
            distance, _ = cKDTree(self._in_body(number, own)).query(points)
            shares[number] = float(np.mean(distance <= REACH_M))
        return shares

    def _in_body(self, number: int, points: Points) -> Points:
        body = self._scene.model.body(self._scene.objects[number]).id
        rotation = self._data.xmat[body].reshape(3, 3)
        return np.asarray((points - self._data.xpos[body]) @ rotation)

    def _world_points(self, geom: int) -> Points:
        """Points on the box about a geom: shape enough for boxes, cylinders and balls of a few cm."""
        box = self._scene.model.geom_aabb[geom]
        local = box[:3] + box_surface(box[3:])
        rotation = self._data.geom_xmat[geom].reshape(3, 3)
        return np.asarray(local @ rotation.T + self._data.geom_xpos[geom])


def box_surface(half: Points) -> Points:
    """Points [P, 3] on the six faces of a box of half sizes [3], about 15 mm apart."""
    faces = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        grid = np.meshgrid(*(_ticks(half[k]) for k in (u, v)), indexing="ij")
        for side in (-1.0, 1.0):
            face = np.empty((grid[0].size, 3))
            face[:, axis] = side * half[axis]
            face[:, u], face[:, v] = grid[0].ravel(), grid[1].ravel()
            faces.append(face)
    return np.concatenate(faces)


def _ticks(half: float) -> Points:
    count = max(1, round(2 * half / _SPACING_M))
    return np.asarray((np.arange(count) + 0.5) / count * 2 * half - half)
