"""Draws the textures of the faces of a model, with mipmaps, and finds the places of points on them."""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from comotion_schemas.errors import InputError

from .drawing import Image
from .scene import Vector, require_mujoco
from .textures import TEXTURES

Points = NDArray[np.float32]
Surface = tuple[NDArray[np.intp], Points, Points, Points]
LEVELS = 4
"""Mipmap levels, each half the size of the one before."""
_ROW = 512  # places per row of a map: cv2.remap accepts rows of at most 32767
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of a geom without one


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


class Face(NamedTuple):
    """Texture of a face: images uint8 [H, W, 3] (BGR) by level, width and height in m, texels per metre."""

    levels: list[Image]
    width: float
    height: float
    scale: float

    def texels(self, level: int, u: NDArray[np.float32], v: NDArray[np.float32]) -> Image:
        """Interpolate texels uint8 [N, 3] at (u, v) float32 [N], m right of and below the centre."""
        image, rows = self.levels[level], -(-len(u) // _ROW)
        places = np.zeros((2, rows * _ROW), np.float32)
        places[0, : len(u)] = (u / self.width + 0.5) * image.shape[1] - 0.5
        places[1, : len(u)] = (v / self.height + 0.5) * image.shape[0] - 0.5
        x, y = places.reshape(2, rows, _ROW)
        texels = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(texels, np.uint8).reshape(-1, 3)[: len(u)]


def _face_sizes(kind: int, size: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Width and height in m of each face of a geom of MuJoCo, by its type and size [3]."""
    geom = require_mujoco().mjtGeom
    a, b, c = (2 * float(v) for v in size)
    if kind == geom.mjGEOM_BOX:
        return [(b, c), (b, c), (a, c), (a, c), (a, b), (a, b)]
    if kind == geom.mjGEOM_CYLINDER:
        return [(np.pi * a, b), (a, a), (a, a)]
    if kind == geom.mjGEOM_SPHERE:
        return [(np.pi * a, np.pi * a / 2)]
    raise InputError(f"the renderer supports boxes, cylinders and spheres, not geoms of type {kind}")


def draw_faces(model: Any, geom: int, seed: int) -> list[Face]:
    """Draw the faces of a geom (box: -x, +x, -y, +y, -z, +z; cylinder: side, bottom, top; sphere: one).

    Raises
    ------
    InputError
        If the geom or its material has no texture.
    """
    material, colour = _material_of(model, geom)
    faces = []
    for index, (width, height) in enumerate(_face_sizes(int(model.geom_type[geom]), model.geom_size[geom])):
        largest = max(width, height)
        # Texels per metre: the resolution of a camera at 1 m for small faces, less for large ones.
        scale = 1200.0 if largest < 0.6 else 900.0 if largest < 1.6 else 320.0
        shape = max(2, round(height * scale)), max(2, round(width * scale))
        levels = [material(np.random.default_rng([seed, geom, index]), *shape, colour, scale)]
        while len(levels) < LEVELS:
            half = tuple(max(1, size // 2) for size in levels[-1].shape[1::-1])
            levels.append(np.asarray(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA), np.uint8))
        faces.append(Face(levels, width, height, scale))
    return faces


def _material_of(model: Any, geom: int) -> tuple[Any, NDArray[np.float64]]:
    rgba = tuple(float(v) for v in model.geom_rgba[geom])
    index = int(model.geom_matid[geom])
    name = model.material(index).name if index >= 0 else "plain"
    if name not in TEXTURES:
        raise InputError(f"no texture {name!r}; materials are named {', '.join(sorted(TEXTURES))}")
    if np.allclose(rgba, _DEFAULT_RGBA) and index >= 0:
        rgba = tuple(float(v) for v in model.mat_rgba[index])
    return TEXTURES[name], np.array(rgba[2::-1]) * 255.0
