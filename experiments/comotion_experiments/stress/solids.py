"""Image trajectories of rigid bodies with depth, seen by a moving perspective camera. Pure.

Bodies are boxes, or planes where an edge is 0. Features lie on their faces; one is seen where its face turns
to the camera, nothing stands before it, and it is within the image. Camera axes: x right, y down, z ahead.
Lengths are in m, angles in rad, times in seconds; positions are in px.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_sources.simulator.motion import Array, Poses

Flags = NDArray[np.bool_]
_NEAREST_M = 0.05
# A point on a face must not be taken for hidden by its own box, whatever rounding does.
_SURFACE_M = 1e-6
_TRIES = 40


@dataclass(frozen=True, kw_only=True)
class Glide:
    """A smooth motion: constant velocity and turn, and a swing.

    x(t) = place + velocity·t + swing·(sin(2π·frequency·t + phase) − sin(phase)),
    R(t) = exp(turn·t)·exp(facing).

    Attributes
    ----------
    place, velocity, swing
        float64 [3]; m, m/s, m.
    facing, turn
        float64 [3], rotation vectors; rad and rad/s.
    frequency, phase
        Hz and rad.
    """

    place: Array
    velocity: Array
    facing: Array
    turn: Array
    swing: Array
    frequency: float = 0.5
    phase: float = 0.0

    def at(self, times: Array) -> Poses:
        """Poses at times [T]."""
        turned = Rotation.from_rotvec(times[:, None] * self.turn) * Rotation.from_rotvec(self.facing)
        swung = np.sin(2 * np.pi * self.frequency * times + self.phase) - np.sin(self.phase)
        moved = self.place + times[:, None] * self.velocity + swung[:, None] * self.swing
        return Poses(np.asarray(turned.as_matrix(), np.float64), np.asarray(moved, np.float64))


@dataclass(frozen=True)
class Solid:
    """A box of `size` [3] (m) about its origin, with so many features; `hollow`: seen from the inside."""

    motion: Glide
    size: Array
    features: int
    object: int
    hollow: bool = False


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """A camera without distortion: `focal` (px), `width` and `height` (px), and its motion."""

    motion: Glide
    focal: float = 525.0
    width: int = 640
    height: int = 480


@dataclass(frozen=True, kw_only=True)
class ImageScene:
    """What an image sequence shows.

    Attributes
    ----------
    solids, camera
        Bodies, some of which may be one object, and who looks at them.
    frames, rate
        Number of images, and Hz.
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
    shortest
        Frames that a feature must be seen in.
    """

    solids: list[Solid]
    camera: Pinhole
    frames: int = 30
    rate: float = 15.0
    sigma: float = 0.3
    drift: float = 0.0
    complete: bool = True
    returns: bool = False
    dropout: float = 0.0
    shortest: int = 5


@dataclass(frozen=True)
class ImageTracks:
    """Trajectories: `times` float64 [F], `positions` float64 [F, N, 2] (NaN: unseen), `objects` int64 [N]."""

    times: Array
    positions: Array
    objects: NDArray[np.int64]


def observe_images(scene: ImageScene, seed: int) -> ImageTracks:
    """Draw features on the bodies of a scene and follow them; the same for the same seed.

    A body of which too little is seen has fewer features than it should.
    """
    times: Array = np.arange(scene.frames, dtype=np.float64) / scene.rate
    rng = np.random.default_rng(seed)
    positions, objects = [np.empty((scene.frames, 0, 2))], [np.empty(0, np.int64)]
    for index, solid in enumerate(scene.solids):
        tracks = _tracks(scene, index, times, rng)
        positions.append(tracks)
        objects.append(np.full(tracks.shape[1], solid.object, np.int64))
    exact = np.concatenate(positions, axis=1)
    noise = scene.sigma * rng.normal(size=exact.shape)
    if scene.drift:
        noise += scene.drift * rng.normal(size=exact.shape).cumsum(axis=0)
    return ImageTracks(times, exact + noise, np.concatenate(objects))


def _tracks(scene: ImageScene, index: int, times: Array, rng: np.random.Generator) -> Array:
    """Exact positions of the features of a body, float64 [F, n, 2]."""
    solid = scene.solids[index]
    chosen = np.empty((len(times), 0, 2))
    for _ in range(_TRIES):
        local, normal = _surface(solid, max(4 * solid.features, 16), rng)
        pixels, seen = _seen(scene, index, local, normal, times)
        if not scene.returns:
            seen = _first_run(seen)
        seen = _dropped(seen, scene.dropout, rng)
        enough = seen.all(axis=0) if scene.complete else seen.sum(axis=0) >= scene.shortest
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
    return local * solid.size, -normal if solid.hollow else normal


def _seen(scene: ImageScene, index: int, local: Array, normal: Array, times: Array) -> tuple[Array, Flags]:
    """Pixels [F, n, 2] of points of a body, and which are seen, bool [F, n]."""
    camera, solid = scene.camera, scene.solids[index]
    eye, pose = camera.motion.at(times), solid.motion.at(times)
    world = np.einsum("tij,nj->tni", pose.rotations, local) + pose.translations[:, None]
    ray = world - eye.translations[:, None]
    ahead = np.einsum("tji,tnj->tni", eye.rotations, ray)
    depth = np.maximum(ahead[..., 2], _NEAREST_M)
    centre = np.array([camera.width, camera.height]) / 2.0
    pixels = camera.focal * ahead[..., :2] / depth[..., None] + centre
    within = (pixels >= 0).all(axis=2) & (pixels < 2 * centre).all(axis=2) & (ahead[..., 2] > _NEAREST_M)
    facing = np.einsum("tij,nj->tni", pose.rotations, normal)
    seen = within & ((facing * ray).sum(axis=2) < 0)
    for other, hiding in enumerate(scene.solids):
        if other != index and not hiding.hollow:
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
