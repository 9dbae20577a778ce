"""What a stress scene is: bodies, features, sources, noise, and what happens when.

Lengths are in m, angles in rad, times in seconds of the scene.
"""

import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion_schemas.types import Unit
from comotion_sources.simulator.actors import Features

from .motion import Array, PoseAt

OUTLIER_FACTOR = 10.0


def rng_of(seed: int, *names: str) -> np.random.Generator:
    """Random numbers of one thing in the scene of a seed, independent of all others."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


@dataclass(frozen=True)
class Body:
    """A rigid body: `features` trackable points uniform in a box of `size` [dim] about its origin.

    Attributes
    ----------
    name
        Unique in the scene.
    motion
        Its poses.
    features
        Features observed at once; a place of a feature (slot) is filled anew when its feature ends.
    size
        float64 [dim].
    sigma
        White noise of an observation, one sigma per axis.
    """

    name: str
    motion: PoseAt
    features: int
    size: Array
    sigma: float = 0.003


@dataclass(frozen=True)
class Source:
    """Who observes: every source sees the slots whose number is its own modulo the number of sources.

    Attributes
    ----------
    name
        Unique in the scene.
    rate
        Hz.
    phase
        Fraction of a period that it is behind.
    rotation, translation
        float64 [dim, dim] and [dim]: error of its extrinsics; it publishes rotation · x + translation.
    clock
        (from, error): from each time on its stamps are wrong by this many seconds.
    sessions
        Times at which a new session begins, besides the start.
    off
        (begin, end) of the times at which it publishes nothing.
    """

    name: str
    rate: float = 15.0
    phase: float = 0.0
    rotation: Array | None = None
    translation: Array | None = None
    clock: tuple[tuple[float, float], ...] = ()
    sessions: tuple[float, ...] = ()
    off: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Noise:
    """What the noise of positions is beside the white noise of each body.

    Attributes
    ----------
    correlation
        s; time constant of first-order autoregressive noise that replaces the white one. 0: white.
    outliers
        Share of observations whose noise is :data:`OUTLIER_FACTOR` times as large.
    walk
        m/√s; random walk of a feature on its body.
    depth
        1/m; noise along the viewing ray is depth · z² beside the white noise, z from the start of the rays
        2 m before the origin. 0: none.
    ray
        White noise along the viewing ray, as a multiple of that across it. 1: as much.
    flying
        Share of the observations that are somewhere between a feature and 0.3 m behind it, along the ray.
    published
        Whether sources publish the covariance of the white noise.
    """

    correlation: float = 0.0
    outliers: float = 0.0
    walk: float = 0.0
    depth: float = 0.0
    ray: float = 1.0
    flying: float = 0.0
    published: bool = False


@dataclass(frozen=True)
class Slip:
    """Motion of features on their bodies: local + amplitude · sin(2π · frequency · t + phase) + drift · t.

    `amplitude` and `drift` float64 [slots, dim], `frequency` and `phase` float64 [slots].
    """

    amplitude: Array
    frequency: Array
    phase: Array
    drift: Array


@dataclass(frozen=True)
class Happening:
    """Something that a service has to get over.

    Attributes
    ----------
    begin, end
        From its first effect until what was lost is back, s.
    bodies
        Indices of the bodies concerned.
    lost
        Whether all features of these were lost.
    """

    begin: float
    end: float
    bodies: tuple[int, ...]
    lost: bool = False


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One run of a family.

    Attributes
    ----------
    bodies, lives, sources, noise, slip
        What is observed, and how.
    seed
        Of the noise.
    duration
        s of the scene.
    start
        s; the service joins then and sees nothing of what was before.
    hidden
        (slot, begin, end): a slot's feature is unobserved for a time and keeps its id.
    happenings
        What the service has to get over, in order of time.
    dim, unit, space
        Coordinate space.
    period
        s between updates.
    sigma_switch
        m; parameter of the thesis method that suits the scene's noise.
    """

    bodies: list[Body]
    lives: Features
    sources: list[Source] = field(default_factory=lambda: [Source("simulator")])
    noise: Noise = field(default_factory=Noise)
    slip: Slip | None = None
    seed: int
    duration: float
    start: float = 0.0
    hidden: list[tuple[int, float, float]] = field(default_factory=list)
    happenings: list[Happening] = field(default_factory=list)
    dim: int = 3
    unit: Unit = "m"
    space: str = "world"
    period: float = 0.2
    sigma_switch: float = 0.01


def slot_bodies(bodies: list[Body]) -> NDArray[np.intp]:
    """Body of each slot, intp [slots]: the slots of the first body come first."""
    return np.repeat(np.arange(len(bodies)), [body.features for body in bodies]).astype(np.intp)
