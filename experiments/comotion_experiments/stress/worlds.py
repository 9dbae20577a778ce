"""What most families start from: a static background, bodies that swing about, and the lives of features."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_sources.simulator.actors import Features
from comotion_sources.simulator.spec import Rest

from .motion import SWINGING, simulated
from .scene import Body, Scene, Source, rng_of, slot_bodies

_BACKGROUND_SIZE = (1.6, 1.6, 1.0)
_SMALLEST, _LARGEST = 0.12, 0.4
Span: TypeAlias = tuple[float, float]
Spans: TypeAlias = list[list[Span]]
"""(birth, death) of the features of each slot, one after another, s."""
Cut: TypeAlias = tuple[float, float, NDArray[np.bool_]]
"""(lost, back, slots): features of these slots (bool [slots]) are lost; new ones come later or at once."""


def draw_lives(bodies: list[Body], spans: Sequence[Sequence[Span]], rng: np.random.Generator) -> Features:
    """Give every life time of every slot a place of its own, which `rng` draws, on the slot's body."""
    rows = [(birth, slot, death) for slot, lives in enumerate(spans) for birth, death in lives]
    birth, slots, death = np.array(sorted(row for row in rows if row[2] > row[0]), np.float64).T
    slot = slots.astype(np.intp)
    body = slot_bodies(bodies)[slot]
    half = np.array([one.size for one in bodies])[body] / 2.0
    local = rng.uniform(-1.0, 1.0, half.shape) * half
    return Features(slot=slot, body=body, local=local, birth=birth, death=death)


def lasting(bodies: list[Body]) -> Spans:
    """Every feature lives for ever."""
    return [[(0.0, np.inf)] for _ in slot_bodies(bodies)]


def respawning(
    bodies: list[Body], duration: float, seed: int, *, share: float = 0.2, every: float = 2.0
) -> Spans:
    """Replace a share of each body's features every so many seconds, as the simulator's 3-D set does."""
    of_slot, rng = slot_bodies(bodies), rng_of(seed, "respawn")
    births = [[0.0] for _ in of_slot]
    for time in np.arange(every, duration - 1e-9, every).tolist():
        for index, body in enumerate(bodies):
            places = np.flatnonzero(of_slot == index)
            for slot in rng.choice(places, round(share * body.features), replace=False).tolist():
                births[slot].append(time)
    return [list(zip(times, [*times[1:], np.inf], strict=True)) for times in births]


def renewed(
    slots: int, duration: float, rng: np.random.Generator, draw: Callable[[np.random.Generator], float]
) -> Spans:
    """Follow each life by the next at once; `draw` draws the length of one, s."""
    spans: Spans = []
    for _ in range(slots):
        time, lives = -draw(rng) * float(rng.uniform()), []
        while time < duration:
            length = draw(rng)
            lives.append((max(time, 0.0), time + length))
            time += length
        spans.append([(birth, death) for birth, death in lives if death > 0.0])
    return spans


def cut(spans: Sequence[Sequence[Span]], cuts: Sequence[Cut]) -> Spans:
    """Lose features at given times; new ones come later or at once."""
    left = [list(lives) for lives in spans]
    for lost, back, slots in cuts:
        for slot in np.flatnonzero(slots).tolist():
            parts = [((birth, min(death, lost)), (max(birth, back), death)) for birth, death in left[slot]]
            left[slot] = [(begin, end) for part in parts for begin, end in part if end > begin]
    return left


def background(features: int = 20, sigma: float = 0.003) -> Body:
    """What rests: points all over the scene."""
    return Body("background", simulated(Rest()), features, np.array(_BACKGROUND_SIZE), sigma)


def swinging_bodies(seed: int, bodies: int, features: int = 8, sigma: float = 0.003) -> list[Body]:
    """Draw bodies of the simulator's 3-D set, in place, size and motion: body 1, body 2 and so on."""
    drawn = []
    for name in (f"body {k + 1}" for k in range(bodies)):
        motion = simulated(SWINGING, rng_of(seed, "motion", name))
        size = rng_of(seed, "size", name).uniform(_SMALLEST, _LARGEST, 3)
        drawn.append(Body(name, motion, features, size, sigma))
    return drawn


def swinging_scene(seed: int, bodies: int = 4, features: int = 8, sigma: float = 0.003) -> list[Body]:
    """Draw a background and bodies that swing."""
    return [background(sigma=sigma), *swinging_bodies(seed, bodies, features, sigma)]


def made(
    seed: int,
    bodies: list[Body],
    duration: float,
    spans: Spans | None = None,
    *,
    rate: float = 15.0,
    **what: Any,
) -> list[Scene]:
    """Make the one scene of a family: these bodies, and features with given life times.

    By default features are replaced as those of the simulator's 3-D set. `rate` is in Hz, of its one source
    unless `what`, other attributes of :class:`Scene`, has sources.
    """
    what.setdefault("sources", [Source("simulator", rate)])
    spans = respawning(bodies, duration, seed) if spans is None else spans
    lives = draw_lives(bodies, spans, rng_of(seed, "places"))
    return [Scene(bodies=bodies, lives=lives, seed=seed, duration=duration, **what)]


def displaced(
    seed: int, name: str, rate: float, phase: float, *, mm: float, degrees: float, ms: float
) -> Source:
    """Make a source with errors of a given size in a drawn direction: extrinsics and clock."""
    rng = rng_of(seed, "source", name)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    return Source(
        name,
        rate,
        phase,
        rotation=np.asarray(Rotation.from_rotvec(axis * np.radians(degrees)).as_matrix(), np.float64),
        translation=way * mm * 1e-3,
        clock=((0.0, ms * 1e-3),) if ms else (),
    )
