"""Families in which something happens to the sources: restarts, covers, rebirths, late starts, loops."""

from dataclasses import replace
from typing import Any

import numpy as np

from .lives import cut
from .motion import at_speed, looped
from .scene import Body, Event, Happening, Scene, Source, rng_of
from .worlds import background, displaced, made, respawning, swinging_body, swinging_scene

_DEMO_SPEED = 12.0 / 38.0
_RATES = (15.0, 30.0, 100.0)
_PHASE_STEP = 0.37
_PHASES = 10


def rebirth(seed: int, *, share: float = 1.0, at: float = 6.0, duration: float = 14.0) -> list[Scene]:
    """Lose a share of all features at one instant; new ones come at once under new ids."""
    return _lost(seed, at, at, share=share, duration=duration)


def cover(seed: int, *, seconds: float = 1.0, at: float = 6.0, duration: float = 16.0) -> list[Scene]:
    """Lose all features for a time; then there are new ones."""
    return _lost(seed, at, at + seconds, share=1.0, duration=duration)


def restart(seed: int, *, silent: float = 0.3, at: float = 6.0, duration: float = 14.0) -> list[Scene]:
    """Restart the tracker: silence, then a new session whose ids count from 0 again."""
    source = Source("simulator", sessions=(at,), off=((at, at + silent),))
    return _lost(seed, at, at + silent, share=1.0, duration=duration, sources=[source])


def loop(seed: int, *, length: float = 8.0, times: int = 2) -> list[Scene]:
    """Replay a recording several times: everything jumps back, the sessions are new."""
    bodies = [replace(body, motion=looped(body.motion, length)) for body in swinging_scene(seed)]
    ends = [length * (k + 1) for k in range(times - 1)]
    spans = respawning(bodies, length * times, seed)
    everything = np.ones(len(spans), np.bool_)
    spans = cut(spans, [(end, end, everything) for end in ends])
    sources = [Source("simulator", sessions=tuple(ends))]
    happenings = [Happening(end, end, "lost", tuple(range(len(bodies)))) for end in ends]
    return made(seed, bodies, length * times, spans, sources=sources, happenings=happenings)


def late_start(
    seed: int,
    *,
    longest: float = 6.0,
    phases: int = _PHASES,
    duration: float = 8.0,
    mm: float = 0.0,
    degrees: float = 0.0,
    ms: float = 0.0,
) -> list[Scene]:
    """Join three sources of 15, 30 and 100 Hz late, at several times; bodies move as in the demo."""
    bodies = [background(), *(_slowly(swinging_body(seed, k + 1, 12)) for k in range(2))]
    spans = respawning(bodies, longest + duration, seed)
    (whole,) = made(seed, bodies, duration, spans, sources=_three_sources(seed, mm, degrees, ms))
    starts = np.linspace(0.0, longest, phases).tolist()
    return [replace(whole, start=start, duration=start + duration) for start in starts]


def _slowly(body: Body) -> Body:
    return replace(body, motion=at_speed(body.motion, _DEMO_SPEED))


def _three_sources(seed: int, mm: float, degrees: float, ms: float) -> list[Source]:
    first = Source("simulator-1", _RATES[0])
    others = enumerate(_RATES[1:], start=1)
    errors = {"mm": mm, "degrees": degrees, "ms": ms}
    return [
        first,
        *(displaced(seed, f"simulator-{k + 1}", r, (_PHASE_STEP * k) % 1.0, **errors) for k, r in others),
    ]


def source_joins(seed: int, *, at: float = 6.0, duration: float = 14.0) -> list[Scene]:
    """Let a second source join a running scene."""
    return _two_sources(seed, duration, ((0.0, at),), at)


def source_leaves(seed: int, *, at: float = 6.0, away: float = 4.0, duration: float = 16.0) -> list[Scene]:
    """Let the second of two sources leave for a time, and come back with the features it had."""
    return _two_sources(seed, duration, ((at, at + away),), at, at + away)


def clock_step(seed: int, *, step: float = 0.2, at: float = 6.0, duration: float = 16.0) -> list[Scene]:
    """Set the clock of the second of two sources while it runs."""
    (scene,) = _two_sources(seed, duration, (), at)
    first, second = scene.sources
    return [replace(scene, sources=[first, replace(second, clock=(*second.clock, (at, step)))])]


def _two_sources(
    seed: int, duration: float, off: tuple[tuple[float, float], ...], begin: float, end: float | None = None
) -> list[Scene]:
    bodies = swinging_scene(seed, bodies=3, features=12)
    second = displaced(seed, "simulator-2", 30.0, _PHASE_STEP, mm=2.0, degrees=0.5, ms=5.0)
    sources = [Source("simulator-1", 15.0), replace(second, off=off)]
    last = begin if end is None else end
    happenings = [Happening(begin, last, "change", tuple(range(len(bodies))))]
    spans = respawning(bodies, duration, seed)
    return made(seed, bodies, duration, spans, sources=sources, happenings=happenings)


def _lost(seed: int, begin: float, end: float, *, share: float, duration: float, **what: Any) -> list[Scene]:
    bodies = swinging_scene(seed)
    spans = respawning(bodies, duration, seed)
    # The same share of every body.
    rng, lost = rng_of(seed, "lost"), np.zeros(len(spans), np.bool_)
    place = 0
    for body in bodies:
        lost[place + rng.permutation(body.features)[: round(share * body.features)]] = True
        place += body.features
    kind: Event = "lost" if share == 1.0 else "change"
    happenings = [Happening(begin, end, kind, tuple(range(len(bodies))))]
    return made(seed, bodies, duration, cut(spans, [(begin, end, lost)]), happenings=happenings, **what)
