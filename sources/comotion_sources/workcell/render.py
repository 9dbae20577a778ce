"""Renders a scene on the CPU by ray casting: image, depth and geom of every pixel.

``mujoco.mj_multiRay`` casts one ray per pixel without OpenGL, GPU or display. Hit points are
transformed to the frame of their geom, so that textures are fixed to the bodies, and looked up in the
texture of the face at the mipmap level for their distance.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..calibration.model import Extrinsics, Intrinsics
from .atlas import LEVELS, Points, draw_faces, surface
from .scene import MOVING, STILL, Scene, Vector, require_mujoco

Rows = NDArray[np.intp]
_Layer = dict[str, NDArray[Any]]
"""Properties of each pixel [N] before shadows are applied: geoms, depth, points, light, texels."""

_AMBIENT, _DIFFUSE = 0.5, 0.62  # brightness in full light: up to 1.12 of the texture
_FAR = 50.0  # length of a ray, in multiples of its vector
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_LIT = 0.985  # a ray from the light that gets this share of the way has reached the point
_SHADOW_STEP = 2  # shadows are computed for every second row and column; their borders are soft anyway
# Shadows are soft and not black, as from a large lamp in a room: a tracker would follow hard borders.
_PENUMBRA = 0.012  # one-sigma blur, as a share of the image width
_SHADOW_DEPTH = 0.45  # share of the light that a shadow takes


class Rendering(NamedTuple):
    """The images of an ideal camera."""

    image: NDArray[np.uint8]  # uint8 [H, W, 3], BGR
    depth: NDArray[np.float32]  # float32 [H, W], z in metres; 0 where nothing is hit
    geoms: NDArray[np.int32]  # int32 [H, W], geom under each pixel, -1 where nothing is hit


class Renderer:
    """Renders a scene for one camera.

    Static geoms are rendered once for each place of the camera. A frame renders only the pixels that moving
    bodies may cover, and the shadows.

    The camera has no distortion.
    """

    def __init__(self, scene: Scene, intrinsics: Intrinsics, extrinsics: Extrinsics) -> None:
        self.scene, self.intrinsics, self.extrinsics = scene, intrinsics, extrinsics
        self._atlas = [draw_faces(scene.model, geom, scene.seed) for geom in range(scene.model.ngeom)]
        self._data = scene.new_data()
        self._shape = intrinsics.height, intrinsics.width
        v, u = np.mgrid[0 : self._shape[0], 0 : self._shape[1]]
        # Rays have z = 1 in the camera frame: the distance along them is then the depth.
        self._optical = intrinsics.rays(np.stack([u.ravel(), v.ravel()], 1))
        self._light = np.array(scene.model.light_pos[0] if scene.model.nlight else (0.0, 0.0, 3.0))
        self._moving = np.flatnonzero(scene.model.geom_group == MOVING)
        sparse = np.arange(u.size, dtype=np.intp).reshape(self._shape)[::_SHADOW_STEP, ::_SHADOW_STEP]
        self._sparse_shape, self._sparse = sparse.shape, sparse.ravel()
        self.move(extrinsics)

    def move(self, extrinsics: Extrinsics) -> None:
        """Move the camera; what is static is rendered anew."""
        self.extrinsics = extrinsics
        self._rays = self._optical @ extrinsics.rotation.T
        geoms, depth = _cast(self.scene.model, self._data, extrinsics.translation, self._rays, STILL)
        kinds = {"geoms": np.int32, "depth": np.float32, "light": np.float32}
        self._still: _Layer = {name: np.zeros(len(geoms), kind) for name, kind in kinds.items()}
        self._still["points"] = np.zeros((len(geoms), 3), np.float32)
        self._still["texels"] = np.zeros((len(geoms), 3), np.uint8)
        self._shade(self._still, np.arange(len(geoms)), geoms, depth)
        self._still_lit = self._reached_by_light(self._still["points"][self._sparse], STILL)

    def render(self, configuration: Vector, t: float = 0.0) -> Rendering:
        """Render the scene.

        The `configuration` is float64 [joints], rad or m; `t` is the time of the scene in s, for the moving
        shadow.
        """
        self.scene.place(self._data, configuration)
        layer = {name: values.copy() for name, values in self._still.items()}
        # The pixels that show a moving body.
        near, model = np.flatnonzero(self._covered()), self.scene.model
        geoms, depth = _cast(model, self._data, self.extrinsics.translation, self._rays[near], MOVING)
        behind = layer["depth"][near]
        visible = (geoms >= 0) & ((depth < behind) | (behind == 0))
        self._shade(layer, near[visible], geoms[visible], depth[visible])
        light = _AMBIENT + layer["light"].reshape(self._shape) * self._illumination(layer)
        light = (light * self._shadow_gain(layer["points"], t)).astype(np.float32)
        texels = layer["texels"].reshape(*self._shape, 3)
        image = cv2.multiply(texels, cv2.merge([light] * 3), dtype=cv2.CV_8U)
        depth, geoms = (layer[name].reshape(self._shape) for name in ("depth", "geoms"))
        return Rendering(np.asarray(image, np.uint8), depth, geoms)

    def _covered(self) -> NDArray[np.bool_]:
        """Mark the pixels around the bounding box of each moving geom."""
        mask = np.zeros(self._shape, bool)
        to_camera = self.extrinsics.inverse()
        for geom in self._moving:
            box, rotation = self.scene.model.geom_aabb[geom], self._data.geom_xmat[geom].reshape(3, 3)
            corners = to_camera.apply(
                (box[:3] + _CORNERS * box[3:]) @ rotation.T + self._data.geom_xpos[geom]
            )
            if (corners[:, 2] <= 0).all():
                continue
            if (corners[:, 2] < 0.05).any():  # at the camera: it may cover any pixel
                mask[:] = True
                break
            pixels = self.intrinsics.project(corners)
            low = np.clip(pixels.min(axis=0) - 1, 0, self._shape[::-1]).astype(int)
            high = np.clip(pixels.max(axis=0) + 2, 0, self._shape[::-1]).astype(int)
            mask[low[1] : high[1], low[0] : high[0]] = True
        return mask.ravel()

    def _shade(self, layer: _Layer, rows: Rows, geoms: NDArray[np.int32], depth: Points) -> None:
        """Put what pixels show into a layer, with their texels and direct light, geom by geom."""
        layer["geoms"][rows], layer["depth"][rows], layer["texels"][rows] = geoms, depth, 0
        rays = self._rays[rows].astype(np.float32)
        layer["points"][rows] = rays * depth[:, None] + self.extrinsics.translation.astype(np.float32)
        order = np.argsort(geoms.astype(np.int16), kind="stable")
        starts = np.searchsorted(geoms[order], np.arange(self.scene.model.ngeom + 1))
        for geom in np.unique(geoms[geoms >= 0]).tolist():
            part = rows[order[starts[geom] : starts[geom + 1]]]
            shaded = self._shade_geom(geom, layer["points"][part], layer["depth"][part])
            layer["texels"][part], layer["light"][part] = shaded

    def _shade_geom(self, geom: int, points: Points, depth: Points) -> tuple[NDArray[np.uint8], Points]:
        rotation = self._data.geom_xmat[geom].reshape(3, 3).astype(np.float32)
        centre = self._data.geom_xpos[geom]
        local = (points - centre.astype(np.float32)) @ rotation
        to_light = (self._light - centre) @ rotation
        to_light = (to_light / np.linalg.norm(to_light)).astype(np.float32)
        face, u, v, cosine = surface(
            int(self.scene.model.geom_type[geom]), self.scene.model.geom_size[geom], local, to_light
        )
        faces = self._atlas[geom]
        footprint = depth * np.array([each.scale for each in faces])[face] / self.intrinsics.fx
        level = np.clip(np.rint(np.log2(np.maximum(footprint, 1e-6))), 0, LEVELS - 1).astype(np.intp)
        texels, image = np.empty((len(points), 3), np.uint8), face * LEVELS + level
        for number in np.unique(image).tolist():
            part = image == number
            texels[part] = faces[number // LEVELS].texels(number % LEVELS, u[part], v[part])
        return texels, np.float32(_DIFFUSE) * np.maximum(cosine, 0)

    def _illumination(self, layer: _Layer) -> Points:
        """Share of the light that reaches each pixel, float32 [H, W], with soft shadow borders."""
        points = layer["points"][self._sparse]
        lit = self._still_lit.copy()
        on_moving = self.scene.model.geom_group[np.maximum(layer["geoms"][self._sparse], 0)] == MOVING
        lit[on_moving] = self._reached_by_light(points[on_moving], STILL)
        lit = np.minimum(lit, self._reached_by_light(points, MOVING)).reshape(self._sparse_shape)
        soft = cv2.GaussianBlur(lit, (0, 0), _PENUMBRA * self._sparse_shape[1])
        full = cv2.resize(soft, self._shape[::-1], interpolation=cv2.INTER_LINEAR)
        return np.asarray(1.0 - _SHADOW_DEPTH * (1.0 - full), np.float32)

    def _reached_by_light(self, points: Points, group: int) -> Points:
        """Whether light reaches points [N, 3] past the geoms of a group: 1 or 0, float32 [N]."""
        rays = points.astype(np.float64) - self._light
        geoms, reach = _cast(self.scene.model, self._data, self._light, rays, group)
        return ((geoms < 0) | (reach > _LIT)).astype(np.float32)

    def _shadow_gain(self, points: Points, t: float) -> Points | np.float32:
        """Brightness factor of the moving shadow of the clutter variants."""
        if not self.scene.shadow:
            return np.float32(1.0)
        amplitude, radius, depth, period = self.scene.shadow
        phase = 2 * np.pi * t / period
        x = points[:, 0] - np.float32(amplitude * np.sin(phase))
        y = points[:, 1] - np.float32(amplitude * 0.5 * np.cos(phase))
        r2 = (x * x + y * y) / np.float32(2 * radius**2)
        return (1.0 - np.float32(depth) * np.exp(-r2)).astype(np.float32).reshape(self._shape)


def _cast(
    model: Any, data: Any, origin: Vector, rays: Vector, group: int
) -> tuple[NDArray[np.int32], Points]:
    """Cast rays [N, 3] of any length from one origin [3], m, at the geoms of one group.

    Returns geom int32 [N], -1 where none is hit; distance float32 [N] in multiples of the ray, 0 where none.
    """
    mujoco = require_mujoco()
    count = len(rays)
    geoms, distances = np.full(count, -1, np.int32), np.zeros(count)
    if not count:
        return geoms, distances.astype(np.float32)
    groups = np.zeros(6, np.uint8)
    groups[group] = 1
    # None: no normals; they are computed from the shape of the geom.
    mujoco.mj_multiRay(model, data, origin, rays.ravel(), groups, 1, -1, geoms, distances, None, count, _FAR)
    return geoms, np.where(geoms >= 0, distances, 0.0).astype(np.float32)
