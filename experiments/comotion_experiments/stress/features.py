"""Families in which features are not what one would wish: short-lived, drifting, sliding, noisy, hidden."""

from collections.abc import Callable
from typing import Any

import numpy as np

from .scene import OUTLIER_FACTOR, Noise, Scene, Slip, rng_of, slot_bodies
from .worlds import background, dropouts, lasting, made, renewed, swinging_bodies, swinging_scene

_SIGMA_PER_SWITCH = 3.3


def short_lives(
    seed: int, *, rate: float = 15.0, shortest: float = 0.3, longest: float = 1.0, duration: float = 15.0
) -> list[Scene]:
    """Let every feature live for a fraction of a second."""
    return _renewed_scene(seed, rate, duration, lambda rng: float(rng.uniform(shortest, longest)))


def renewal(
    seed: int, *, rate: float = 15.0, share: float = 0.3, shortest: float = 0.3, duration: float = 15.0
) -> list[Scene]:
    """Replace a share of the features every second, each at a time of its own."""
    mean = 1.0 / share - shortest
    return _renewed_scene(seed, rate, duration, lambda rng: shortest + float(rng.exponential(mean)))


def _renewed_scene(
    seed: int, rate: float, duration: float, life: Callable[[np.random.Generator], float]
) -> list[Scene]:
    """Bodies that move, and features that live for as long as `life` draws, s."""
    bodies = swinging_scene(seed, features=10)
    spans = renewed(len(slot_bodies(bodies)), duration, rng_of(seed, "lives"), life)
    return made(seed, bodies, duration, spans, rate=rate)


def drift(
    seed: int, *, bodies: int = 0, walk: float = 0.002, speed: float = 0.0, duration: float = 15.0
) -> list[Scene]:
    """Let features drift on their bodies: a random walk (m/√s), or slowly in a direction (m/s)."""
    all_bodies = [background(40), *swinging_bodies(seed, bodies)]
    slots, rng = len(slot_bodies(all_bodies)), rng_of(seed, "drift")
    way = rng.normal(size=(slots, 3))
    way *= speed * rng.uniform(0.0, 2.0, (slots, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    still = np.zeros(slots)
    slip = Slip(np.zeros((slots, 3)), still, still, way) if speed else None
    return made(seed, all_bodies, duration, lasting(all_bodies), noise=Noise(walk=walk), slip=slip)


def sliding(
    seed: int, *, bodies: int = 3, share: float = 0.3, reach: float = 0.04, duration: float = 15.0
) -> list[Scene]:
    """Let a share of the features of moving bodies slide along edges, as corners at an outline do.

    The features of an edge slide together as the view of it turns, each by an amount of its own.
    """
    all_bodies = swinging_scene(seed, bodies, features=12)
    of_slot, rng = slot_bodies(all_bodies), rng_of(seed, "sliding")
    slots = len(of_slot)
    amplitude, frequency, phase = np.zeros((slots, 3)), np.zeros(slots), np.zeros(slots)
    for index in range(1, len(all_bodies)):
        places = np.flatnonzero(of_slot == index)
        sliders = rng.permutation(places)[: round(share * len(places))]
        for edge in range(2):
            mine = sliders[edge::2]
            amplitude[mine, rng.integers(3)] = reach * rng.uniform(0.5, 1.5, len(mine))
            frequency[mine], phase[mine] = rng.uniform(0.1, 0.3), rng.uniform(0, 2 * np.pi)
    slip = Slip(amplitude, frequency, phase, np.zeros((slots, 3)))
    return made(seed, all_bodies, duration, slip=slip)


def noisy(
    seed: int,
    *,
    bodies: int = 3,
    background_features: int = 20,
    features: int = 10,
    sigma: float = 0.003,
    duration: float = 15.0,
    **noise: Any,
) -> list[Scene]:
    """Bodies, or none, seen with much noise: white, or with other attributes of :class:`Noise`."""
    all_bodies = [background(background_features, sigma), *swinging_bodies(seed, bodies, features, sigma)]
    how = Noise(**noise)
    spans = None if bodies else lasting(all_bodies)
    largest = sigma * (OUTLIER_FACTOR * how.outliers + how.ray)
    switch = _SIGMA_PER_SWITCH * max(largest, 4.0 * how.depth)
    return made(seed, all_bodies, duration, spans, noise=how, sigma_switch=switch)


def gaps(
    seed: int,
    *,
    every: float = 3.0,
    shortest: float = 0.2,
    longest: float = 1.5,
    duration: float = 15.0,
) -> list[Scene]:
    """Hide every feature now and then; it keeps its id."""
    bodies = swinging_scene(seed)
    rng = rng_of(seed, "gaps")
    slots = len(slot_bodies(bodies))
    hidden = dropouts(slots, duration, rng, every=every, shortest=shortest, longest=longest)
    return made(seed, bodies, duration, hidden=hidden)
