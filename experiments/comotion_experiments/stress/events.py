"""Families in which something happens to the sources: restarts, covers, rebirths, late starts, loops."""

from dataclasses import replace

import numpy as np

from .motion import at_speed, looped
from .scene import Happening, Scene, Source, rng_of
from .worlds import background, cut, displaced, made, respawning, swinging_scene

_DEMO_SPEED = 12.0 / 38.0
_RATES = (15.0, 30.0, 100.0)
_PHASE_STEP = 0.37


def lost(
    seed: int,
    *,
    share: float = 1.0,
    seconds: float = 0.0,
    restarts: bool = False,
    at: float = 6.0,
    duration: float = 14.0,
) -> list[Scene]:
    """Lose a share of all features for a time; then there are new ones under new ids.

    Where the tracker `restarts`, it is silent for this time, and its new session counts ids from 0 again.
    """
    bodies, end = swinging_scene(seed), at + seconds
    spans = respawning(bodies, duration, seed)
    # The same share of every body.
    rng, gone = rng_of(seed, "lost"), np.zeros(len(spans), np.bool_)
    place = 0
    for body in bodies:
        gone[place + rng.permutation(body.features)[: round(share * body.features)]] = True
        place += body.features
    happening = Happening(at, end, tuple(range(len(bodies))), lost=share == 1.0)
    source = Source("simulator", sessions=(at,), off=((at, end),)) if restarts else Source("simulator")
    spans = cut(spans, [(at, end, gone)])
    return made(seed, bodies, duration, spans, sources=[source], happenings=[happening])


def loop(seed: int, *, length: float = 8.0, times: int = 2) -> list[Scene]:
    """Replay a recording several times: everything jumps back, the sessions are new."""
    bodies = [replace(body, motion=looped(body.motion, length)) for body in swinging_scene(seed)]
    ends = [length * (k + 1) for k in range(times - 1)]
    spans = respawning(bodies, length * times, seed)
    everything = np.ones(len(spans), np.bool_)
    spans = cut(spans, [(end, end, everything) for end in ends])
    sources = [Source("simulator", sessions=tuple(ends))]
    happenings = [Happening(end, end, tuple(range(len(bodies))), lost=True) for end in ends]
    return made(seed, bodies, length * times, spans, sources=sources, happenings=happenings)


def late_start(
    seed: int,
    *,
    longest: float = 6.0,
    phases: int = 10,
    duration: float = 8.0,
    mm: float = 0.0,
    degrees: float = 0.0,
    ms: float = 0.0,
) -> list[Scene]:
    """Join three sources of 15, 30 and 100 Hz late, at several times; bodies move as in the demo."""
    moving = swinging_scene(seed, bodies=2, features=12)[1:]
    bodies = [background(), *(replace(body, motion=at_speed(body.motion, _DEMO_SPEED)) for body in moving)]
    sources = [Source("simulator-1", _RATES[0])]
    for k, rate in enumerate(_RATES[1:], start=1):
        phase = (_PHASE_STEP * k) % 1.0
        sources.append(displaced(seed, f"simulator-{k + 1}", rate, phase, mm=mm, degrees=degrees, ms=ms))
    spans = respawning(bodies, longest + duration, seed)
    (whole,) = made(seed, bodies, duration, spans, sources=sources)
    starts = np.linspace(0.0, longest, phases).tolist()
    return [replace(whole, start=start, duration=start + duration) for start in starts]


def two_sources(
    seed: int,
    *,
    at: float = 6.0,
    away: float = 0.0,
    joins: bool = False,
    step: float = 0.0,
    duration: float = 16.0,
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
