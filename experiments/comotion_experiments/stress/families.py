"""How the scenes of families are made; ``families.toml`` has the parameters of each."""

from dataclasses import replace
from typing import Any

import numpy as np

from comotion_sources.simulator.spec import KeyStates, Sines

from .scene import (
    OUTLIER_FACTOR,
    SIGMA_M,
    Body,
    Happening,
    Noise,
    Scene,
    Slip,
    Source,
    at_speed,
    background,
    chained,
    cut,
    displaced,
    lasting,
    looped,
    made,
    renewed,
    respawning,
    rng_of,
    simulated,
    slot_bodies,
    stopping,
    swinging_bodies,
    swinging_scene,
)

_DEMO_SPEED = 12.0 / 38.0
_RATES = (15.0, 30.0, 100.0)
_PHASE_STEP = 0.37
_SIGMA_PER_SWITCH = 3.3


def lost(
    seed: int, *, share: float, seconds: float, restarts: bool, at: float, duration: float
) -> list[Scene]:
    """Lose a share of all features for a time; then there are new ones under new ids.

    Where the tracker `restarts`, it is silent for this time, and its new session counts ids from 0 again.
    """
    bodies, end = swinging_scene(seed), at + seconds
    # The same share of every body.
    rng, gone, place = rng_of(seed, "lost"), np.zeros(len(slot_bodies(bodies)), np.bool_), 0
    for body in bodies:
        gone[place + rng.permutation(body.features)[: round(share * body.features)]] = True
        place += body.features
    happening = Happening(at, end, tuple(range(len(bodies))), lost=share == 1.0)
    source = Source("simulator", sessions=(at,), off=((at, end),)) if restarts else Source("simulator")
    spans = cut(respawning(bodies, duration, seed), [(at, end, gone)])
    return made(seed, bodies, duration, spans, sources=[source], happenings=[happening])


def loop(seed: int, *, length: float, times: int) -> list[Scene]:
    """Replay a recording several times: everything jumps back, the sessions are new."""
    bodies = [replace(body, motion=looped(body.motion, length)) for body in swinging_scene(seed)]
    ends = [length * (k + 1) for k in range(times - 1)]
    everything = np.ones(len(slot_bodies(bodies)), np.bool_)
    spans = cut(respawning(bodies, length * times, seed), [(end, end, everything) for end in ends])
    sources = [Source("simulator", sessions=tuple(ends))]
    happenings = [Happening(end, end, tuple(range(len(bodies))), lost=True) for end in ends]
    return made(seed, bodies, length * times, spans, sources=sources, happenings=happenings)


def late_start(seed: int, *, longest: float, phases: int, duration: float, **wrong: float) -> list[Scene]:
    """Join three sources of 15, 30 and 100 Hz late, at several times; bodies move as in the demo.

    What is `wrong` of the second and third is as in :func:`.displaced`.
    """
    moving = swinging_bodies(seed, 2, features=12)
    bodies = [background(), *(replace(body, motion=at_speed(body.motion, _DEMO_SPEED)) for body in moving)]
    sources = [Source("simulator-1", _RATES[0])]
    for k, rate in enumerate(_RATES[1:], start=1):
        sources.append(displaced(seed, f"simulator-{k + 1}", rate, (_PHASE_STEP * k) % 1.0, **wrong))
    spans = respawning(bodies, longest + duration, seed)
    (whole,) = made(seed, bodies, duration, spans, sources=sources)
    starts = np.linspace(0.0, longest, phases).tolist()
    return [replace(whole, start=start, duration=start + duration) for start in starts]


def two_sources(
    seed: int, *, at: float, away: float, joins: bool, step: float, duration: float
) -> list[Scene]:
    """Let the second of two sources join a running scene, be away for a time, or set its clock by a step (s).

    After its time away it comes back with the features it had.
    """
    bodies = swinging_scene(seed, bodies=3, features=12)
    second = displaced(seed, "simulator-2", 30.0, _PHASE_STEP, mm=2.0, degrees=0.5, ms=5.0)
    off = (0.0, at) if joins else (at, at + away)
    clock = (*second.clock, (at, step)) if step else second.clock
    sources = [Source("simulator-1", 15.0), replace(second, off=(off,), clock=clock)]
    happenings = [Happening(at, at + away, tuple(range(len(bodies))))]
    return made(seed, bodies, duration, sources=sources, happenings=happenings)


def renewal(
    seed: int, *, rate: float, shortest: float, longest: float, share: float, duration: float
) -> list[Scene]:
    """Let every feature live for a time up to the `longest`, or replace a share of them every second."""

    def life(rng: np.random.Generator) -> float:
        return float(rng.uniform(shortest, longest) if longest else shortest + rng.exponential(mean))

    bodies, mean = swinging_scene(seed, features=10), 1.0 / share - shortest if share else 0.0
    spans = renewed(len(slot_bodies(bodies)), duration, rng_of(seed, "lives"), life)
    return made(seed, bodies, duration, spans, rate=rate)


def drift(seed: int, *, bodies: int, walk: float, speed: float, duration: float) -> list[Scene]:
    """Let features drift on their bodies: a random walk (m/√s), or slowly in a direction (m/s)."""
    all_bodies = [background(40), *swinging_bodies(seed, bodies)]
    slots, rng = len(slot_bodies(all_bodies)), rng_of(seed, "drift")
    way = rng.normal(size=(slots, 3))
    way *= speed * rng.uniform(0.0, 2.0, (slots, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    slip = replace(Slip.none(slots), drift=way) if speed else None
    return made(seed, all_bodies, duration, lasting(all_bodies), noise=Noise(walk=walk), slip=slip)


def sliding(seed: int, *, bodies: int, share: float, reach: float, duration: float) -> list[Scene]:
    """Let a share of the features of moving bodies slide along edges, as corners at an outline do.

    The features of an edge slide together as the view of it turns, each by an amount of its own.
    """
    all_bodies = swinging_scene(seed, bodies, features=12)
    of_slot, rng = slot_bodies(all_bodies), rng_of(seed, "sliding")
    slip = Slip.none(len(of_slot))
    for index in range(1, len(all_bodies)):
        places = np.flatnonzero(of_slot == index)
        sliders = rng.permutation(places)[: round(share * len(places))]
        for edge in range(2):
            of_edge = sliders[edge::2]
            slip.amplitude[of_edge, rng.integers(3)] = reach * rng.uniform(0.5, 1.5, len(of_edge))
            slip.frequency[of_edge], slip.phase[of_edge] = rng.uniform(0.1, 0.3), rng.uniform(0, 2 * np.pi)
    return made(seed, all_bodies, duration, slip=slip)


def soft(seed: int, *, bodies: int, amplitude: float, duration: float) -> list[Scene]:
    """Let every feature of a moving body swing about its place by an amplitude (m)."""
    all_bodies = swinging_scene(seed, bodies, features=12)
    slots, rng = len(slot_bodies(all_bodies)), rng_of(seed, "soft")
    way = rng.normal(size=(slots, 3))
    way *= amplitude / np.linalg.norm(way, axis=1, keepdims=True)
    way[: all_bodies[0].features] = 0.0
    frequency, phase = rng.uniform(0.2, 0.8, slots), rng.uniform(0.0, 2.0 * np.pi, slots)
    return made(seed, all_bodies, duration, slip=Slip(way, frequency, phase, np.zeros((slots, 3))))


def noisy(
    seed: int,
    *,
    bodies: int,
    background_features: int,
    features: int,
    sigma: float,
    duration: float,
    **noise: Any,
) -> list[Scene]:
    """Bodies, or none, seen with much noise: white, or with other attributes of :class:`Noise`."""
    all_bodies = [background(background_features, sigma), *swinging_bodies(seed, bodies, features, sigma)]
    how = Noise(**noise)
    spans = None if bodies else lasting(all_bodies)
    largest = sigma * (OUTLIER_FACTOR * how.outliers + how.ray)
    return made(seed, all_bodies, duration, spans, noise=how, sigma_switch=_SIGMA_PER_SWITCH * largest)


def stops(
    seed: int, *, bodies: int, first: float, every: float, seconds: float, moving: bool, duration: float
) -> list[Scene]:
    """Stop bodies that are `moving`, or start them, one `every` so often; for some seconds, or for good."""
    times = [first + every * k for k in range(bodies)]
    switches = [[t, t + seconds] if seconds else [t] for t in times]
    return _stopping(seed, switches, duration, moving=moving, renewal=0.0)


def stop_and_go(seed: int, *, bodies: int, duration: float, renewal: float, **how: Any) -> list[Scene]:
    """Let bodies move for 2 to 6 s and rest for 2 to 25 s, again and again; `renewal`: share a 2 s."""
    all_switches = []
    for k in range(bodies):
        rng = rng_of(seed, "stops", str(k))
        switches, time, moving = [], float(rng.uniform(2.0, 6.0)), True
        while time < duration:
            switches.append(time)
            moving = not moving
            time += float(rng.uniform(2.0, 6.0) if moving else rng.uniform(2.0, 25.0))
        all_switches.append(switches)
    return _stopping(seed, all_switches, duration, moving=True, renewal=renewal, **how)


def _stopping(
    seed: int, switches: list[list[float]], duration: float, *, moving: bool, renewal: float, **how: float
) -> list[Scene]:
    """Bodies that stop or start at the times of each."""
    pairs = zip(swinging_bodies(seed, len(switches)), switches, strict=True)
    bodies = [replace(body, motion=stopping(body.motion, times, moving=moving)) for body, times in pairs]
    bodies = [background(), *bodies]
    spans = respawning(bodies, duration, seed, share=renewal) if renewal else lasting(bodies)
    return made(seed, bodies, duration, spans, **how)


def covers(
    seed: int, *, bodies: int, first: float, every: float, seconds: float, duration: float, **how: float
) -> list[Scene]:
    """Hide one object after the other for seconds while it moves on; it returns with new features."""
    all_bodies = swinging_scene(seed, bodies)
    times = np.arange(first, duration - every, every).tolist()
    happenings = [Happening(t, t + seconds, (1 + k % bodies,), lost=True) for k, t in enumerate(times)]
    of_slot = slot_bodies(all_bodies)
    cuts = [(happening.begin, happening.end, of_slot == happening.bodies[0]) for happening in happenings]
    spans = cut(respawning(all_bodies, duration, seed), cuts)
    return made(seed, all_bodies, duration, spans, happenings=happenings, **how)


def slow(seed: int, *, bodies: int, speed: float, duration: float) -> list[Scene]:
    """Slow bodies."""
    moving = (replace(body, motion=at_speed(body.motion, speed)) for body in swinging_bodies(seed, bodies))
    return made(seed, [background(), *moving], duration)


def hinge(seed: int, *, degrees: float, at: float, seconds: float, sigma: float = SIGMA_M) -> list[Scene]:
    """Open a door by a few degrees; it stays open."""
    rng = rng_of(seed, "hinge")
    width, height = rng.uniform(0.35, 0.5), rng.uniform(0.5, 0.7)
    angle = np.radians(degrees) * rng.choice([-1.0, 1.0])
    # The origin of a body is its middle; the door turns about its edge at x = -width / 2.
    place, reach = 0.2, width / 2
    states = [
        [at + seconds * s, place + reach * np.cos(angle * s), reach * np.sin(angle * s), 0, 0, 0, angle * s]
        for s in np.linspace(0.0, 1.0, 20).tolist()
    ]
    motion = simulated(KeyStates(kind="key-states", states=states))
    door = Body("door", motion, 12, np.array([width, 0.02, height]), sigma)
    bodies = [background(24, sigma), door]
    return made(seed, bodies, at + seconds + 10.0, lasting(bodies))


def arm(seed: int, *, duration: float) -> list[Scene]:
    """Swing an arm of two links about a fixed shoulder; the second turns about the end of the first."""
    lengths = rng_of(seed, "lengths").uniform(0.3, 0.4, 2)
    turning = Sines(kind="sines", amplitude=0.0, rotation=1.0)
    turns = [simulated(turning, rng_of(seed, "motion", name)) for name in ("link 1", "link 2")]
    size = np.array([lengths[0], 0.08, 0.08])
    links = [Body(f"link {k}", chained(turns[:k], lengths[:k]), 10, size) for k in (1, 2)]
    return made(seed, [background(), *links], duration)
