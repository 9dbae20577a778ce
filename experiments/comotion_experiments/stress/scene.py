"""What a stress scene is: bodies, features, sources, noise, and what happens when.

Lengths are in m, angles in rad, times in seconds of the scene.
"""

import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comotion_sources.simulator.actors import Features

from .motion import Array, PoseAt

OUTLIER_FACTOR = 10.0
SIGMA_M = 0.003
"""White noise of an observation, one sigma per axis, unless a family says otherwise."""


def rng_of(seed: int, *names: str) -> np.random.Generator:
    """Random numbers of one thing in the scene of a seed, independent of all others."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


@dataclass(frozen=True)
class Body:
    """A rigid body: trackable points uniform in a box about its origin."""

    name: str  # unique in the scene
    motion: PoseAt
    features: int  # observed at once; a place of a feature (slot) is filled anew when its feature ends
    size: Array  # of the box, float64 [3]
    sigma: float = SIGMA_M


@dataclass(frozen=True)
class Source:
    """Who observes: every source sees the slots whose number is its own modulo the number of sources."""

    name: str  # unique in the scene
    rate: float = 15.0  # Hz
    phase: float = 0.0  # fraction of a period that it is behind
    # Error of its extrinsics, float64 [3, 3] and [3]: it publishes rotation · x + translation.
    rotation: Array | None = None
    translation: Array | None = None
    clock: tuple[tuple[float, float], ...] = ()  # (from, error): from each time on its stamps are wrong by it
    sessions: tuple[float, ...] = ()  # when a new session begins, besides the start
    off: tuple[tuple[float, float], ...] = ()  # (begin, end) of the times at which it publishes nothing


@dataclass(frozen=True)
class Noise:
    """What the noise of positions is beside the white noise of each body."""

    correlation: float = 0.0  # s; of first-order autoregressive noise that replaces the white one; 0: white
    outliers: float = 0.0  # share of observations whose noise is OUTLIER_FACTOR times as large
    walk: float = 0.0  # m/√s; random walk of a feature on its body
    # White noise along the viewing ray, as a multiple of that across it; rays start 2 m before the origin.
    ray: float = 1.0
    flying: float = 0.0  # share that is somewhere between a feature and 0.3 m behind it, along the ray
    published: bool = False  # whether sources publish the covariance of the white noise


@dataclass(frozen=True)
class Slip:
    """Motion of features on their bodies: local + amplitude · sin(2π · frequency · t + phase) + drift · t.

    `amplitude` and `drift` float64 [slots, 3], `frequency` and `phase` float64 [slots].
    """

    amplitude: Array
    frequency: Array
    phase: Array
    drift: Array

    @classmethod
    def none(cls, slots: int) -> "Slip":
        """None yet, in arrays of its own."""
        return cls(np.zeros((slots, 3)), np.zeros(slots), np.zeros(slots), np.zeros((slots, 3)))


@dataclass(frozen=True)
class Happening:
    """Something that a service has to get over."""

    begin: float  # its first effect
    end: float  # what was lost is back
    bodies: tuple[int, ...]  # indices of those concerned
    lost: bool = False  # whether all features of these were lost


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One run of a family."""

    bodies: list[Body]
    lives: Features
    sources: list[Source] = field(default_factory=lambda: [Source("simulator")])
    noise: Noise = field(default_factory=Noise)
    slip: Slip | None = None
    seed: int  # of the noise
    duration: float
    start: float = 0.0  # the service joins then and sees nothing of what was before
    happenings: list[Happening] = field(default_factory=list)  # in order of time
    period: float = 0.2  # s between updates
    sigma_switch: float = 0.01  # m; parameter of the thesis method that suits the scene's noise


def slot_bodies(bodies: list[Body]) -> NDArray[np.intp]:
    """Body of each slot, intp [slots]: the slots of the first body come first."""
    return np.repeat(np.arange(len(bodies)), [body.features for body in bodies]).astype(np.intp)
