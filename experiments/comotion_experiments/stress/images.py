"""Families of image sequences: bodies with depth before a moving camera, few features, degenerate motion."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from ..pixels.sequences import Sequence
from .motion import Array, glide
from .scene import rng_of
from .solids import FRAMES_HZ, ImageScene, Solid, observe_images

# Three points and a few more: an affine motion is known and can be checked.
_FEWEST = 6
# Where bodies of 0.3 to 0.6 m stand; the camera looks at what is this much farther than the nearest.
_NEAR_M, _LOOKS_AT = 1.5, 1.5
_FOCAL_PX = 525.0


Numbers: TypeAlias = tuple[int, int]
Span: TypeAlias = tuple[float, float]
"""Range that a number of each scene is drawn from."""


@dataclass(frozen=True, kw_only=True)
class ImageParameters:
    """What image sequences of a family have in common; pairs are ranges."""

    scenes: int = 6  # sequences of a seed
    bodies: Numbers = (2, 2)  # that move
    features: Numbers = (20, 60)  # of each
    background: Numbers = (100, 200)  # features
    depth: Span = (1.5, 6.0)  # m; where the background is, from its nearest to its farthest part
    speed: Span = (0.1, 0.3)  # m/s, of the bodies
    spin: Span = (10.0, 40.0)  # °/s
    camera_speed: Span = (0.2, 0.5)  # m/s
    camera_spin: Span = (2.0, 10.0)  # °/s
    axial: bool = False  # the camera moves along its axis, and does not turn
    flat: bool = False  # bodies and background are planes
    # The camera stands so many times as far away, with so many times the focal length: the image stays, its
    # perspective weakens.
    zoom: Span = (1.0, 1.0)
    frames: int = 30  # at 15 Hz
    sigma: float = 0.3  # px; noise of an observation, per axis
    drift: float = 0.0  # px per root of a frame; random walk of a feature on its body, per axis
    complete: bool = True  # only features that are seen in all frames
    returns: bool = False  # whether a feature that was hidden goes on under its id; otherwise it ends
    dropout: float = 0.0  # share of the features that are besides lost at some time for good, or begin late


def image_sequences(name: str, seed: int, **parameters: Any) -> list[Sequence]:
    """Make labelled sequences; the same for the same seed, name and :class:`ImageParameters`.

    A sequence of which nothing is seen in enough frames is left out.
    """
    how = ImageParameters(**parameters)
    made = [
        _sequence(f"{name}_{seed}_{k}", rng_of(seed, "images", name, str(k)), how) for k in range(how.scenes)
    ]
    return [sequence for sequence in made if len(sequence.truth)]


def _sequence(name: str, rng: np.random.Generator, how: ImageParameters) -> Sequence:
    """Film a scene, and add noise; objects of which too little is seen to know how they move are left out."""
    count = _whole(rng, how.bodies)
    # Drawn apart, so that the scene does not depend on it.
    zoom = float(rng_of(0, "zoom", name).uniform(*how.zoom))
    times: Array = np.arange(how.frames, dtype=np.float64) / FRAMES_HZ
    camera = _camera(rng, how, zoom)
    solids = _background(rng, how)
    solids += [_body(rng, how, number, count) for number in range(count)]
    scene = ImageScene(solids, camera, zoom * _FOCAL_PX, times)
    noises = np.random.default_rng(int(rng.integers(2**31)))
    seen: dict[str, Any] = {name: getattr(how, name) for name in ("complete", "returns", "dropout")}
    positions, truth = observe_images(scene, noises, **seen)
    noise = how.sigma * noises.normal(size=positions.shape)
    if how.drift:
        noise += how.drift * noises.normal(size=positions.shape).cumsum(axis=0)
    objects, counts = np.unique(truth, return_counts=True)
    sequence = Sequence(name, positions + noise, times, truth)
    return sequence.of(np.isin(truth, objects[counts >= _FEWEST]))


def _camera(rng: np.random.Generator, how: ImageParameters, zoom: float) -> Any:
    """Move sideways while looking at one place and turning besides, or ahead."""
    target = _LOOKS_AT * how.depth[0]
    place = np.array([0.0, 0.0, (1.0 - zoom) * target])
    if how.axial:
        return glide(place, np.array([0.0, 0.0, rng.uniform(*how.camera_speed)]))
    velocity = _direction(rng) * np.array([1.0, 0.6, 0.5]) * rng.uniform(*how.camera_speed)
    look = np.array([velocity[1], -velocity[0], 0.0]) / (target * zoom)
    besides = _direction(rng) * np.array([0.3 / zoom, 0.3 / zoom, 1.0])
    besides *= np.radians(rng.uniform(*how.camera_spin))
    swing = _direction(rng) * rng.uniform(*how.camera_speed) * 0.1
    return glide(place, velocity, turn=look + besides, swing=swing)


def _background(rng: np.random.Generator, how: ImageParameters) -> list[Solid]:
    """Make a wall, and before it a floor and some boxes that rest; all are object 1."""
    features, (near, far) = _whole(rng, how.background), how.depth
    wall = glide(np.array([0.0, 0.0, far])), np.array([3.0 * far, 3.0 * far, 0.0])
    if how.flat:
        return [Solid(*wall, features, 1)]
    share, middle = features // 4, (near + far) / 2
    level = glide(np.array([0.0, 0.25 * middle, middle]))
    rest = [Solid(level, np.array([2.0 * far, 0.0, far - near]), share, 1)]
    for side in (-1.0, 1.0):
        z = near + (far - near) * rng.uniform(0.1, 0.6)
        place = np.array([side * rng.uniform(0.3, 0.5) * z, rng.uniform(-0.25, 0.1) * z, z])
        size = rng.uniform(0.15, 0.35, 3) * z
        rest.append(Solid(glide(place, facing=_direction(rng) * 0.5), size, share, 1))
    return [Solid(*wall, features - 3 * share, 1), *rest]


def _body(rng: np.random.Generator, how: ImageParameters, number: int, count: int) -> Solid:
    """Place a body in its part of the image before the background; the speed goes with the scene's size."""
    scale = how.depth[0] / _NEAR_M
    z = how.depth[0] * rng.uniform(0.8, 1.3)
    across = (number + 0.5) / count - 0.5 + rng.uniform(-0.1, 0.1)
    motion = glide(
        np.array([0.8 * across * z, rng.uniform(-0.2, 0.2) * z, z]),
        _direction(rng) * np.array([1.0, 0.7, 0.7]) * rng.uniform(*how.speed) * scale,
        facing=_direction(rng) * rng.uniform(0.0, 1.0),
        turn=_direction(rng) * np.radians(rng.uniform(*how.spin)),
        swing=_direction(rng) * rng.uniform(*how.speed) * 0.2 * scale,
    )
    size = rng.uniform(0.3, 0.6, 3) * np.array([1.0, 1.0, 0.0 if how.flat else 1.0]) * scale
    return Solid(motion, size, _whole(rng, how.features), number + 2)


def _direction(rng: np.random.Generator) -> Array:
    way = rng.normal(size=3)
    return np.asarray(way / np.linalg.norm(way), np.float64)


def _whole(rng: np.random.Generator, bounds: tuple[int, int]) -> int:
    return int(rng.integers(bounds[0], bounds[1] + 1))
