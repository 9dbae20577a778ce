"""Families in which bodies move in their own way: rest, stop and go, slow, soft, hinged, coupled, hidden."""

from dataclasses import replace
from typing import Any

import numpy as np

from comotion_schemas.errors import KnownError
from comotion_sources.simulator import load_scene
from comotion_sources.simulator.spec import Body as BodySpec
from comotion_sources.simulator.spec import Sines

from .motion import PoseAt, at_speed, chained, coupled, key_states, simulated, stopping
from .scene import Body, Happening, Scene, Slip, rng_of, slot_bodies
from .worlds import background, cut, lasting, made, replaced, respawning, swinging_bodies, swinging_scene


def rest(
    seed: int, *, bodies: int = 3, stop: float = 6.0, seconds: float = 14.0, duration: float = 26.0
) -> list[Scene]:
    """Stop all bodies for longer than the window, then let them move on."""
    return _stopping(seed, [[stop, stop + seconds]] * bodies, duration)


def late_movers(
    seed: int, *, bodies: int = 3, first: float = 3.0, every: float = 4.0, duration: float = 18.0
) -> list[Scene]:
    """Let bodies that have rested start one after the other."""
    return _stopping(seed, [[first + every * k] for k in range(bodies)], duration, moving=False)


def stop_and_go(
    seed: int,
    *,
    bodies: int = 3,
    duration: float = 120.0,
    renewal: float = 0.05,
    rate: float = 15.0,
    period: float = 1 / 3,
) -> list[Scene]:
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
    return _stopping(seed, all_switches, duration, renewal=renewal, rate=rate, period=period)


def ten_minutes(
    seed: int,
    *,
    duration: float = 600.0,
    rate: float = 10.0,
    period: float = 0.5,
    every: float = 30.0,
    seconds: float = 2.0,
) -> list[Scene]:
    """Move for ten minutes with features replaced, and an object hidden every half minute."""
    bodies = swinging_scene(seed, 3)
    hidden = [(t, t + seconds, 1 + k % 3) for k, t in enumerate(np.arange(every, duration - every, every))]
    return _with_hidden(seed, bodies, hidden, duration, rate=rate, period=period)


def object_cover(
    seed: int, *, bodies: int = 4, first: float = 6.0, every: float = 5.0, seconds: float = 3.0
) -> list[Scene]:
    """Hide one object after the other for seconds while it moves on; it returns with new features."""
    hidden = [(first + every * k, first + every * k + seconds, 1 + k) for k in range(bodies)]
    return _with_hidden(seed, swinging_scene(seed, bodies), hidden, first + every * bodies + 2.0)


def slow(seed: int, *, bodies: int = 3, speed: float = 0.1, duration: float = 30.0) -> list[Scene]:
    """Slow bodies."""
    moving = (replace(body, motion=at_speed(body.motion, speed)) for body in swinging_bodies(seed, bodies))
    return made(seed, [background(), *moving], duration)


def slowed_figure(seed: int, *, scene: str = "fig4_4", speed: float = 0.2) -> list[Scene]:
    """Play a figure of the thesis slowly; its features are replaced as much more rarely."""
    spec = load_scene(scene)
    bodies = [
        Body(
            body.name,
            at_speed(simulated(body.motion, rng_of(seed, "motion", body.name), spec.dim), speed),
            body.features,
            _size(body),
            body.sigma,
        )
        for body in spec.bodies
    ]
    duration = spec.duration / speed
    spans = lasting(bodies)
    if spec.respawn is not None:
        rng = rng_of(seed, "respawn")
        spans = replaced(bodies, duration, rng, share=spec.respawn.share, every=spec.respawn.every / speed)
    where: dict[str, Any] = {"dim": spec.dim, "unit": spec.unit, "space": spec.space}
    return made(seed, bodies, duration, spans, period=1 / 3, **where)


def _size(body: BodySpec) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    if not isinstance(body.size, list):
        raise KnownError(f"body {body.name!r}: the size is not fixed")
    return np.array(body.size, np.float64)


def soft(seed: int, *, bodies: int = 3, amplitude: float = 0.01, duration: float = 15.0) -> list[Scene]:
    """Let every feature of a moving body swing about its place by an amplitude (m)."""
    all_bodies = swinging_scene(seed, bodies, features=12)
    slots, rng = len(slot_bodies(all_bodies)), rng_of(seed, "soft")
    way = rng.normal(size=(slots, 3))
    way *= amplitude / np.linalg.norm(way, axis=1, keepdims=True)
    way[: all_bodies[0].features] = 0.0
    frequency, phase = rng.uniform(0.2, 0.8, slots), rng.uniform(0.0, 2.0 * np.pi, slots)
    slip = Slip(way, frequency, phase, np.zeros((slots, 3)))
    return made(seed, all_bodies, duration, slip=slip)


def hinge(
    seed: int, *, degrees: float = 10.0, at: float = 5.0, seconds: float = 2.0, sigma: float = 0.003
) -> list[Scene]:
    """Open a door by a few degrees; it stays open."""
    rng = rng_of(seed, "hinge")
    width, height = rng.uniform(0.35, 0.5), rng.uniform(0.5, 0.7)
    angle = np.radians(degrees) * rng.choice([-1.0, 1.0])
    # The origin of a body is its middle; the door turns about its edge at x = -width / 2.
    steps = np.linspace(0.0, 1.0, 20)
    place, reach = 0.2, width / 2
    states = [
        [at + seconds * s, place + reach * np.cos(angle * s), reach * np.sin(angle * s), 0, 0, 0, angle * s]
        for s in steps.tolist()
    ]
    door = Body("door", key_states(states), 12, np.array([width, 0.02, height]), sigma)
    bodies = [background(24, sigma), door]
    return made(seed, bodies, at + seconds + 10.0, lasting(bodies))


def coupled_pair(seed: int, *, until: float = 8.0, duration: float = 18.0) -> list[Scene]:
    """Let two bodies move as one, then apart."""
    leader, follower, third = swinging_bodies(seed, 3, features=10)
    offset = rng_of(seed, "offset").uniform(-0.3, 0.3, 3)
    follower = replace(follower, motion=coupled(leader.motion, follower.motion, until, offset))
    return made(seed, [background(), leader, follower, third], duration)


def arm(seed: int, *, duration: float = 15.0, sigma: float = 0.003) -> list[Scene]:
    """Swing an arm of two links about a fixed shoulder; the second turns about the end of the first."""
    lengths = rng_of(seed, "lengths").uniform(0.3, 0.4, 2)
    first, second = (_turning(seed, f"link {k + 1}") for k in range(2))
    size = np.array([lengths[0], 0.08, 0.08])
    links = [
        Body("link 1", chained([first], lengths[:1]), 10, size, sigma),
        Body("link 2", chained([first, second], lengths), 10, size, sigma),
    ]
    return made(seed, [background(sigma=sigma), *links], duration)


def _turning(seed: int, name: str) -> PoseAt:
    return simulated(Sines(kind="sines", amplitude=0.0, rotation=1.0), rng_of(seed, "motion", name))


def _stopping(
    seed: int,
    switches: list[list[float]],
    duration: float,
    *,
    moving: bool = True,
    renewal: float = 0.0,
    **how: float,
) -> list[Scene]:
    """Bodies that stop or start at the times of each."""
    pairs = zip(swinging_bodies(seed, len(switches)), switches, strict=True)
    bodies = [replace(body, motion=stopping(body.motion, times, moving=moving)) for body, times in pairs]
    bodies = [background(), *bodies]
    rng = rng_of(seed, "respawn")
    spans = replaced(bodies, duration, rng, share=renewal, every=2.0) if renewal else lasting(bodies)
    return made(seed, bodies, duration, spans, **how)


def _with_hidden(
    seed: int,
    bodies: list[Body],
    hidden: list[tuple[float, float, int]],
    duration: float,
    **how: float,
) -> list[Scene]:
    """Hide whole bodies: (begin, end, body)."""
    of_slot = slot_bodies(bodies)
    cuts = [(begin, end, of_slot == body) for begin, end, body in hidden]
    spans = cut(respawning(bodies, duration, seed), cuts)
    happenings = [Happening(begin, end, (body,), lost=True) for begin, end, body in hidden]
    return made(seed, bodies, duration, spans, happenings=happenings, **how)
