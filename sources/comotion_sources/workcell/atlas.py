"""Packs the textures of all faces of a model into one image with mipmaps.

With a single image one call of cv2.remap samples every pixel.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .drawing import Image
from .extra import require_mujoco
from .textures import TEXTURES

LEVELS = 4
"""Mipmap levels, each half the size of the one before."""
_PAD = 8  # texels of repeated border: one at the coarsest level
_WIDTH = 4096  # texels; cv2.remap accepts at most 32767
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's colour of a geom without one


@dataclass(frozen=True, eq=False)
class Atlas:
    """The image with its mipmap levels, and the faces of each geom.

    Attributes
    ----------
    image
        uint8 [H, W, 3], BGR: the levels one below the other.
    level_tops
        float32 [LEVELS], first row of each level.
    faces
        Per geom float32 [faces, 5] (box: -x, +x, -y, +y, -z, +z; cylinder: side, bottom, top; sphere: one):
        texel x, y of the upper left corner, half width and half height in m, texels per metre.
    """

    image: Image
    level_tops: NDArray[np.float32]
    faces: list[NDArray[np.float32]]


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


def build_atlas(model: Any, seed: int) -> Atlas:
    """Draw the textures of all faces of a model and pack them.

    Raises
    ------
    InputError
        If a geom or material has no texture.
    """
    images: list[Image] = []
    sizes: list[list[tuple[float, float, float]]] = []
    for geom in range(model.ngeom):
        material, colour = _material_of(model, geom)
        faces = _face_sizes(int(model.geom_type[geom]), model.geom_size[geom])
        sizes.append([(width / 2, height / 2, _resolution(width, height)) for width, height in faces])
        for index, (half_w, half_h, scale) in enumerate(sizes[-1]):
            shape = max(2, round(2 * half_h * scale)), max(2, round(2 * half_w * scale))
            images.append(material(np.random.default_rng([seed, geom, index]), *shape, colour, scale))
    image, corners = _pack(images)
    corner = iter(corners)
    placed = [np.array([(*next(corner), *face) for face in faces], np.float32) for faces in sizes]
    return Atlas(*_with_levels(image), placed)


def _material_of(model: Any, geom: int) -> tuple[Any, NDArray[np.float64]]:
    rgba = tuple(float(v) for v in model.geom_rgba[geom])
    index = int(model.geom_matid[geom])
    name = model.material(index).name if index >= 0 else "plain"
    if name not in TEXTURES:
        raise InputError(f"no texture {name!r}; materials are named {', '.join(sorted(TEXTURES))}")
    if np.allclose(rgba, _DEFAULT_RGBA) and index >= 0:
        rgba = tuple(float(v) for v in model.mat_rgba[index])
    return TEXTURES[name], np.array(rgba[2::-1]) * 255.0


def _resolution(width: float, height: float) -> float:
    """Texels per metre: the resolution of a camera at 1 m for small faces, less for large ones."""
    largest = max(width, height)
    return 1200.0 if largest < 0.6 else 900.0 if largest < 1.6 else 320.0


def _pack(images: list[Image]) -> tuple[Image, list[tuple[int, int]]]:
    """Pack images in rows, tallest first; repeated borders keep interpolation within a face."""
    padded = [cv2.copyMakeBorder(i, _PAD, _PAD, _PAD, _PAD, cv2.BORDER_REPLICATE) for i in images]
    corners: list[tuple[int, int]] = [(0, 0)] * len(images)
    x = y = row = 0
    for index in sorted(range(len(images)), key=lambda i: -padded[i].shape[0]):
        height, width = padded[index].shape[:2]
        if x + width > _WIDTH:
            x, y, row = 0, y + row, 0
        corners[index] = (x, y)
        x, row = x + width, max(row, height)
    bottom = -(-(y + row) // 2**LEVELS) * 2**LEVELS
    atlas = np.zeros((bottom, _WIDTH, 3), np.uint8)
    for (left, top), image in zip(corners, padded, strict=True):
        atlas[top : top + image.shape[0], left : left + image.shape[1]] = image
    return atlas, [(left + _PAD, top + _PAD) for left, top in corners]


def _with_levels(image: Image) -> tuple[Image, NDArray[np.float32]]:
    levels = [image]
    for _ in range(LEVELS - 1):
        half = (levels[-1].shape[1] // 2, levels[-1].shape[0] // 2)
        levels.append(np.asarray(cv2.resize(levels[-1], half, interpolation=cv2.INTER_AREA), np.uint8))
    tops = np.cumsum([0] + [level.shape[0] for level in levels[:-1]]).astype(np.float32)
    tall = np.zeros((sum(level.shape[0] for level in levels), _WIDTH, 3), np.uint8)
    for top, level in zip(tops.astype(int), levels, strict=True):
        tall[top : top + level.shape[0], : level.shape[1]] = level
    return tall, tops
