"""Life times of features: who is born and lost when. Pure functions of the bodies and the seed."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .motion import Array
from .scene import Body, Lives, slot_bodies

Span: TypeAlias = tuple[float, float]
Spans: TypeAlias = list[list[Span]]
"""(birth, death) of the features of each slot, one after another, s."""
Cut: TypeAlias = tuple[float, float, NDArray[np.bool_]]
"""(lost, back, slots): features of these slots (bool [slots]) are lost; new ones come later or at once."""


def draw_lives(bodies: list[Body], spans: Sequence[Sequence[Span]], rng: np.random.Generator) -> Lives:
    """Give every life time of every slot a place of its own on the slot's body.

    Parameters
    ----------
    bodies
        The scene's.
    spans
        Per slot (birth, death), s.
    rng
        Draws the places.
    """
    of_slot = slot_bodies(bodies)
    rows = [
        (birth, slot, death) for slot, lives in enumerate(spans) for birth, death in lives if death > birth
    ]
    rows.sort()
    slot = np.array([row[1] for row in rows], np.intp)
    half = np.array([body.size for body in bodies])[of_slot[slot]] / 2.0
    return Lives(
        slot=slot,
        body=of_slot[slot],
        local=rng.uniform(-1.0, 1.0, half.shape) * half,
        birth=np.array([row[0] for row in rows], np.float64),
        death=np.array([row[2] for row in rows], np.float64),
    )


def lasting(slots: int) -> Spans:
    """Every feature lives for ever."""
    return [[(0.0, np.inf)] for _ in range(slots)]


def replaced(
    bodies: list[Body], duration: float, rng: np.random.Generator, *, share: float, every: float
) -> Spans:
    """Replace a share of each body's features at once every so many seconds, as the simulator does."""
    births: list[list[float]] = [[0.0] for body in bodies for _ in range(body.features)]
    of_slot = slot_bodies(bodies)
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
            left[slot] = [part for span in left[slot] for part in _without(span, lost, back)]
    return left


def _without(span: Span, lost: float, back: float) -> list[Span]:
    birth, death = span
    if death <= lost or birth >= back:
        return [span]
    parts = [(birth, lost), (back, death)]
    return [(begin, end) for begin, end in parts if end > begin]


def dropouts(
    slots: int, duration: float, rng: np.random.Generator, *, every: float, shortest: float, longest: float
) -> list[tuple[int, float, float]]:
    """Hide slots for a while now and then: (slot, begin, end), s.

    Parameters
    ----------
    slots, duration, rng
        Of the scene.
    every
        s; mean time between the end of one gap and the begin of the next.
    shortest, longest
        s; length of a gap.
    """
    gaps = []
    for slot in range(slots):
        time = float(rng.exponential(every))
        while time < duration:
            end = time + float(rng.uniform(shortest, longest))
            gaps.append((slot, time, end))
            time = end + float(rng.exponential(every))
    return gaps


def places_of(lives: Lives, body: int) -> Array:
    """First place of every slot of a body, float64 [features, dim]."""
    mine = np.flatnonzero(lives.body == body)
    _, first = np.unique(lives.slot[mine], return_index=True)
    return lives.local[mine[first]]
