"""Image trajectories of rigid bodies with depth, seen by a moving perspective camera. Pure.

Bodies are boxes, or planes where an edge is 0. Features lie on their faces; one is seen where its face turns
to the camera, nothing stands before it, and it is within the image. Camera axes: x right, y down, z ahead.
Lengths are in m, angles in rad, times in seconds; positions are in px.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_sources.simulator.motion import Array, Poses

from ..pixels.sequences import Sequence

Flags = NDArray[np.bool_]
_NEAREST_M = 0.05
# A point on a face must not be taken for hidden by its own box, whatever rounding does.
_SURFACE_M = 1e-6
_TRIES = 40
_RATE_HZ = 15.0
_SIZE_PX = (640, 480)
# Frames that a feature must be seen in.
_SHORTEST = 5


def _zero() -> Array:
    return np.zeros(3)


@dataclass(frozen=True)
class Glide:
    """A smooth motion: constant velocity and turn, and a swing of half a Hz.

    x(t) = place + velocity·t + swing·sin(π·t), R(t) = exp(turn·t)·exp(facing).

    Attributes
    ----------
    place, velocity, swing
        float64 [3]; m, m/s, m.
    facing, turn
        float64 [3], rotation vectors; rad and rad/s.
    """

    place: Array
    velocity: Array = field(default_factory=_zero)
    facing: Array = field(default_factory=_zero)
    turn: Array = field(default_factory=_zero)
    swing: Array = field(default_factory=_zero)

    def at(self, times: Array) -> Poses:
        """Poses at times [T]."""
        turned = Rotation.from_rotvec(times[:, None] * self.turn) * Rotation.from_rotvec(self.facing)
        swung = np.sin(np.pi * times)
        moved = self.place + times[:, None] * self.velocity + swung[:, None] * self.swing
        return Poses(np.asarray(turned.as_matrix(), np.float64), np.asarray(moved, np.float64))


@dataclass(frozen=True)
class Solid:
    """A box of `size` [3] (m) about its origin, with so many features."""

    motion: Glide
    size: Array
    features: int
    object: int


@dataclass(frozen=True, kw_only=True)
class Filming:
    """How an image sequence is taken, at 15 Hz.

    Attributes
    ----------
    frames
        Number of images.
    sigma
        px; noise of an observation, per axis.
    drift
        px per root of a frame; random walk of a feature on its body, per axis.
    complete
        Only features that are seen in all frames.
    returns
        Whether a feature that was hidden goes on under its id; otherwise it ends.
    dropout
        Share of the features that are besides lost at some time for good, or begin late.
    """

    frames: int = 30
    sigma: float = 0.3
    drift: float = 0.0
    complete: bool = True
    returns: bool = False
    dropout: float = 0.0


@dataclass(frozen=True)
class ImageScene:
    """Bodies, some of which may be one object, and a camera of a focal length (px) that looks at them."""

    solids: list[Solid]
    camera: Glide
    focal: float
    how: Filming


def observe_images(name: str, scene: ImageScene, seed: int) -> Sequence:
    """Draw features on the bodies of a scene and follow them; the same for the same seed.

    A body of which too little is seen has fewer features than it should.
    """
    times: Array = np.arange(scene.how.frames, dtype=np.float64) / _RATE_HZ
    rng = np.random.default_rng(seed)
    tracks = [_tracks(scene, index, times, rng) for index in range(len(scene.solids))]
    objects = np.repeat([solid.object for solid in scene.solids], [part.shape[1] for part in tracks])
    exact = np.concatenate(tracks, axis=1)
    noise = scene.how.sigma * rng.normal(size=exact.shape)
    if scene.how.drift:
        noise += scene.how.drift * rng.normal(size=exact.shape).cumsum(axis=0)
    return Sequence(name, exact + noise, times, objects)


def _tracks(scene: ImageScene, index: int, times: Array, rng: np.random.Generator) -> Array:
    """Exact positions of the features of a body, float64 [F, n, 2]."""
    solid, how = scene.solids[index], scene.how
    chosen = np.empty((len(times), 0, 2))
    for _ in range(_TRIES):
        local, normal = _surface(solid, max(4 * solid.features, 16), rng)
        pixels, seen = _seen(scene, index, local, normal, times)
        if not how.returns:
            seen = _first_run(seen)
        seen = _dropped(seen, how.dropout, rng)
        enough = seen.all(axis=0) if how.complete else seen.sum(axis=0) >= _SHORTEST
        picked = np.where(seen[:, enough, None], pixels[:, enough], np.nan)
        chosen = np.concatenate([chosen, picked], axis=1)
        if chosen.shape[1] >= solid.features:
            break
    return chosen[:, : solid.features]


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


def _seen(scene: ImageScene, index: int, local: Array, normal: Array, times: Array) -> tuple[Array, Flags]:
    """Pixels [F, n, 2] of points of a body, and which are seen, bool [F, n]."""
    eye, pose = scene.camera.at(times), scene.solids[index].motion.at(times)
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
            seen &= ~_hides(hiding, eye.translations, ray, times)
    return pixels, seen


def _hides(solid: Solid, eye: Array, ray: Array, times: Array) -> Flags:
    """Whether a box stands between the eye [F, 3] and the ends of rays [F, n, 3], bool [F, n]."""
    pose = solid.motion.at(times)
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
