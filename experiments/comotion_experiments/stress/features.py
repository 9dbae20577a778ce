"""Families in which features are not what one would wish: short-lived, drifting, sliding, noisy, hidden."""

from collections.abc import Callable

import numpy as np

from .lives import dropouts, renewed
from .scene import Body, Noise, Scene, Slip, rng_of, slot_bodies
from .worlds import background, made, respawning, swinging_scene

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
    spans = renewed(_slots(bodies), duration, rng_of(seed, "lives"), life)
    return made(seed, bodies, duration, spans, rate=rate)


def drift(
    seed: int, *, bodies: int = 0, walk: float = 0.002, speed: float = 0.0, duration: float = 15.0
) -> list[Scene]:
    """Let features drift on their bodies: a random walk (m/√s), or slowly in a direction (m/s)."""
    all_bodies = [background(40), *swinging_scene(seed, bodies)[1:]]
    slots, rng = _slots(all_bodies), rng_of(seed, "drift")
    way = rng.normal(size=(slots, 3))
    way *= speed * rng.uniform(0.0, 2.0, (slots, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    still = np.zeros(slots)
    slip = Slip(np.zeros((slots, 3)), still, still, way) if speed else None
    return made(seed, all_bodies, duration, noise=Noise(walk=walk), slip=slip)


def sliding(
    seed: int, *, bodies: int = 3, share: float = 0.3, reach: float = 0.04, duration: float = 15.0
) -> list[Scene]:
    """Let a share of the features of moving bodies slide along edges, as corners at an outline do.

    The features of an edge slide together as the view of it turns, each by an amount of its own.
    """
    all_bodies = swinging_scene(seed, bodies, features=12)
    slots, rng = _slots(all_bodies), rng_of(seed, "sliding")
    amplitude, frequency, phase = np.zeros((slots, 3)), np.zeros(slots), np.zeros(slots)
    of_slot = slot_bodies(all_bodies)
    for index in range(1, len(all_bodies)):
        places = np.flatnonzero(of_slot == index)
        sliders = rng.permutation(places)[: round(share * len(places))]
        for edge in range(2):
            mine = sliders[edge::2]
            amplitude[mine, rng.integers(3)] = reach * rng.uniform(0.5, 1.5, len(mine))
            frequency[mine], phase[mine] = rng.uniform(0.1, 0.3), rng.uniform(0, 2 * np.pi)
    slip = Slip(amplitude, frequency, phase, np.zeros((slots, 3)))
    return made(seed, all_bodies, duration, respawning(all_bodies, duration, seed), slip=slip)


def correlated(
    seed: int, *, bodies: int = 0, seconds: float = 0.5, sigma: float = 0.003, duration: float = 15.0
) -> list[Scene]:
    """Noise that is correlated in time: a first-order autoregression of a given time constant."""
    all_bodies = [background(40, sigma), *swinging_scene(seed, bodies, sigma=sigma)[1:]]
    return _noisy(seed, all_bodies, Noise(correlation=seconds), duration)


def heavy(
    seed: int,
    *,
    sigma: float = 0.003,
    outliers: float = 0.0,
    depth: float = 0.0,
    duration: float = 15.0,
) -> list[Scene]:
    """Much noise: white, with wild observations, or along the viewing ray with the depth squared (1/m)."""
    noise = Noise(outliers=outliers, depth=depth)
    return _noisy(seed, swinging_scene(seed, 3, 10, sigma), noise, duration)


def depth_camera(
    seed: int,
    *,
    bodies: int = 0,
    ratio: float = 3.0,
    flying: float = 0.0,
    published: bool = False,
    sigma: float = 0.0015,
    duration: float = 12.0,
) -> list[Scene]:
    """What an RGB-D camera sees: its noise along the ray is a multiple of that across it."""
    all_bodies = [background(40, sigma), *swinging_scene(seed, bodies, 12, sigma)[1:]]
    noise = Noise(ray=ratio, flying=flying, published=published)
    return _noisy(seed, all_bodies, noise, duration)


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
    hidden = dropouts(_slots(bodies), duration, rng, every=every, shortest=shortest, longest=longest)
    return made(seed, bodies, duration, respawning(bodies, duration, seed), hidden=hidden)


def _noisy(seed: int, bodies: list[Body], noise: Noise, duration: float) -> list[Scene]:
    moving = len(bodies) > 1
    spans = respawning(bodies, duration, seed) if moving else None
    largest = bodies[0].sigma * (noise.outlier_factor * noise.outliers + noise.ray)
    switch = _SIGMA_PER_SWITCH * max(largest, 4.0 * noise.depth)
    return made(seed, bodies, duration, spans, noise=noise, sigma_switch=switch)


def _slots(bodies: list[Body]) -> int:
    return sum(body.features for body in bodies)
