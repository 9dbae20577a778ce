"""Image trajectories of rigid bodies with depth, seen by a moving perspective camera. Pure.

Bodies are boxes, or planes where an edge is 0. Features lie on their faces; one is seen where its face turns
to the camera, nothing stands before it, and it is within the image. Camera axes: x right, y down, z ahead.
Lengths are in m, angles in rad, times in seconds; positions are in px.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .motion import Array, PoseAt

Flags = NDArray[np.bool_]
FRAMES_HZ = 15.0
_NEAREST_M = 0.05
# A point on a face must not be taken for hidden by its own box, whatever rounding does.
_SURFACE_M = 1e-6
_TRIES = 40
_SIZE_PX = (640, 480)
# Frames that a feature must be seen in.
_SHORTEST = 5


@dataclass(frozen=True)
class Solid:
    """A box of `size` [3] (m) about its origin, with so many features."""

    motion: PoseAt
    size: Array
    features: int
    object: int


@dataclass(frozen=True)
class ImageScene:
    """Bodies, some of which may be one object, and a camera of a focal length (px); `times` [F] of images."""

    solids: list[Solid]
    camera: PoseAt
    focal: float
    times: Array


def observe_images(
    scene: ImageScene, rng: np.random.Generator, *, complete: bool, returns: bool, dropout: float
) -> tuple[Array, NDArray[np.int64]]:
    """Draw features on the bodies of a scene and follow them; the options are those of `ImageParameters`.

    A body of which too little is seen has fewer features than it should.

    Returns
    -------
    Exact positions float64 [F, N, 2], px, NaN where a feature is not seen, and its object int64 [N].
    """
    tracks = []
    for index, solid in enumerate(scene.solids):
        chosen = np.empty((len(scene.times), 0, 2))
        for _ in range(_TRIES):
            local, normal = _surface(solid, max(4 * solid.features, 16), rng)
            pixels, seen = _seen(scene, index, local, normal)
            seen = _dropped(seen if returns else _first_run(seen), dropout, rng)
            enough = seen.all(axis=0) if complete else seen.sum(axis=0) >= _SHORTEST
            picked = np.where(seen[:, enough, None], pixels[:, enough], np.nan)
            chosen = np.concatenate([chosen, picked], axis=1)
            if chosen.shape[1] >= solid.features:
                break
        tracks.append(chosen[:, : solid.features])
    objects = np.repeat([solid.object for solid in scene.solids], [part.shape[1] for part in tracks])
    return np.concatenate(tracks, axis=1), objects.astype(np.int64)


def _surface(solid: Solid, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw points [count, 3] uniformly on the faces of a box, with their outward normals [count, 3]."""
    x, y, z = solid.size
    areas = np.repeat([y * z, x * z, x * y], 2)
    face = rng.choice(6, count, p=areas / areas.sum())
    axis, side = face // 2, np.where(face % 2, 0.5, -0.5)
    local = rng.uniform(-0.5, 0.5, (count, 3))
    local[np.arange(count), axis] = side
    normal = np.zeros((count, 3))
    normal[np.arange(count), axis] = np.sign(side)
    return local * solid.size, normal


def _seen(scene: ImageScene, index: int, local: Array, normal: Array) -> tuple[Array, Flags]:
    """Pixels [F, n, 2] of points of a body, and which are seen, bool [F, n]."""
    eye, pose = scene.camera(scene.times), scene.solids[index].motion(scene.times)
    world = np.einsum("tij,nj->tni", pose.rotations, local) + pose.translations[:, None]
    ray = world - eye.translations[:, None]
    ahead = np.einsum("tji,tnj->tni", eye.rotations, ray)
    depth = np.maximum(ahead[..., 2], _NEAREST_M)
    centre = np.array(_SIZE_PX) / 2.0
    pixels = scene.focal * ahead[..., :2] / depth[..., None] + centre
    within = (pixels >= 0).all(axis=2) & (pixels < 2 * centre).all(axis=2) & (ahead[..., 2] > _NEAREST_M)
    facing = np.einsum("tij,nj->tni", pose.rotations, normal)
    seen = within & ((facing * ray).sum(axis=2) < 0)
    for other, hiding in enumerate(scene.solids):
        if other != index:
            seen &= ~_hides(hiding, eye.translations, ray, scene.times)
    return pixels, seen


def _hides(solid: Solid, eye: Array, ray: Array, times: Array) -> Flags:
    """Whether a box stands between the eye [F, 3] and the ends of rays [F, n, 3], bool [F, n]."""
    pose = solid.motion(times)
    start = np.einsum("tji,tj->ti", pose.rotations, eye - pose.translations)[:, None]
    way = np.einsum("tji,tnj->tni", pose.rotations, ray)
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    half = solid.size / 2.0
    low, high = (-half - start) / way, (half - start) / way
    enters = np.minimum(low, high).max(axis=2)
    leaves = np.maximum(low, high).min(axis=2)
    return np.asarray((enters < leaves) & (leaves > 0) & (enters < 1.0 - _SURFACE_M), np.bool_)


def _first_run(seen: Flags) -> Flags:
    """Keep what is seen without a break from the first time on, bool [F, n]."""
    begun = np.maximum.accumulate(seen, axis=0)
    broken = np.maximum.accumulate(begun & ~seen, axis=0)
    return np.asarray(seen & ~broken, np.bool_)


def _dropped(seen: Flags, share: float, rng: np.random.Generator) -> Flags:
    """Let a share of the features end early or begin late, bool [F, n]."""
    frames, count = seen.shape
    dropped, late = rng.uniform(size=count) < share, rng.uniform(size=count) < 0.5
    at = rng.integers(1, max(frames, 2), count)
    number = np.arange(frames)[:, None]
    lost = dropped & np.where(late, number < at, number >= at)
    return np.asarray(seen & ~lost, np.bool_)
