"""Finds face, place on the face and cosine to the light of points on a geom."""

import numpy as np
from numpy.typing import NDArray

from .extra import require_mujoco
from .scene import Vector

Points = NDArray[np.float32]
Surface = tuple[NDArray[np.intp], Points, Points, Points]


def surface(kind: int, size: Vector, local: Points, to_light: Points) -> Surface:
    """Locate points on the surface of a geom.

    Parameters
    ----------
    kind, size
        MuJoCo's geom type and size.
    local
        float32 [N, 3], points in the frame of the geom, m.
    to_light
        float32 [3], unit vector in the frame of the geom.

    Returns
    -------
    Face intp [N]; u, v float32 [N], metres right of and below the centre of the face, as observed from
    outside with z up; cosine of the angle between normal and light, float32 [N].
    """
    geom = require_mujoco().mjtGeom
    if kind == geom.mjGEOM_BOX:
        return _box(size, local, to_light)
    if kind == geom.mjGEOM_CYLINDER:
        return _cylinder(size, local, to_light)
    return _sphere(size, local, to_light)


def _box(size: Vector, local: Points, to_light: Points) -> Surface:
    axis = np.argmax(np.abs(local) / size.astype(np.float32), axis=1)
    outward = np.where(local[np.arange(len(local)), axis] > 0, 1, 0)
    sign = np.where(outward, 1, -1).astype(np.float32)
    x, y, z = local.T
    u = np.where(axis == 0, sign * y, np.where(axis == 1, -sign * x, sign * x))
    v = np.where(axis == 2, -y, -z)
    return 2 * axis + outward, u, v, sign * to_light[axis]


def _cylinder(size: Vector, local: Points, to_light: Points) -> Surface:
    radius, half = np.float32(size[0]), np.float32(size[1])
    x, y, z = local.T
    cap = np.abs(z) / half > np.hypot(x, y) / radius
    face = np.where(cap, np.where(z > 0, 2, 1), 0)
    u = np.where(cap, np.where(z > 0, x, -x), radius * np.arctan2(y, x))
    side = (x * to_light[0] + y * to_light[1]) / radius
    return face, u, np.where(cap, -y, -z), np.where(cap, np.sign(z) * to_light[2], side)


def _sphere(size: Vector, local: Points, to_light: Points) -> Surface:
    radius = np.float32(size[0])
    x, y, z = local.T
    u = radius * np.arctan2(y, x)
    v = -radius * np.arcsin(np.clip(z / radius, -1, 1))
    return np.zeros(len(local), np.intp), u, v, local @ to_light / radius
