"""The bodies most families start from: a static background and bodies that swing about."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from .lives import Spans, draw_lives, lasting, replaced
from .motion import SWINGING, Array, PoseAt, resting, simulated
from .scene import Body, Lives, Scene, Source, rng_of

BACKGROUND_SIZE = (1.6, 1.6, 1.0)
_SMALLEST, _LARGEST = 0.12, 0.4
# The simulator's respawning: a fifth of the features every 2 s.
RESPAWN_SHARE, RESPAWN_EVERY_S = 0.2, 2.0


def background(features: int = 20, sigma: float = 0.003) -> Body:
    """What rests: points all over the scene."""
    return Body("background", resting(), features, np.array(BACKGROUND_SIZE), sigma)


def swinging_body(seed: int, number: int, features: int = 8, sigma: float = 0.003) -> Body:
    """Draw a body of the simulator's 3-D set, in place, size and motion."""
    name = f"body {number}"
    return Body(name, swinging(seed, name), features, box(seed, name), sigma)


def swinging(seed: int, name: str) -> PoseAt:
    """Draw a motion of the simulator's 3-D set."""
    return simulated(SWINGING, rng_of(seed, "motion", name))


def box(seed: int, name: str) -> Array:
    """Draw the edges of a body, float64 [3]."""
    return rng_of(seed, "size", name).uniform(_SMALLEST, _LARGEST, 3)


def swinging_scene(seed: int, bodies: int = 4, features: int = 8, sigma: float = 0.003) -> list[Body]:
    """Draw a background and bodies that swing."""
    return [background(sigma=sigma), *(swinging_body(seed, k + 1, features, sigma) for k in range(bodies))]


def respawning(bodies: list[Body], duration: float, seed: int) -> Spans:
    """Replace features as the simulator's 3-D set does."""
    rng = rng_of(seed, "respawn")
    return replaced(bodies, duration, rng, share=RESPAWN_SHARE, every=RESPAWN_EVERY_S)


def lives_of(bodies: list[Body], seed: int, spans: Spans | None = None) -> Lives:
    """Draw the places of features with given life times; by default they live for ever."""
    slots = sum(body.features for body in bodies)
    return draw_lives(bodies, lasting(slots) if spans is None else spans, rng_of(seed, "places"))


def made(
    seed: int,
    bodies: list[Body],
    duration: float,
    spans: Spans | None = None,
    *,
    rate: float = 15.0,
    **what: Any,
) -> list[Scene]:
    """Make the one scene of a family: these bodies, and features with given life times, for ever by default.

    Parameters
    ----------
    seed, bodies, duration
        Of the scene.
    spans
        Life times of the features of each slot, see :mod:`.lives`.
    rate
        Hz of its one source, unless `what` has sources.
    what
        Other attributes of :class:`Scene`.
    """
    what.setdefault("sources", [Source("simulator", rate)])
    return [Scene(bodies=bodies, lives=lives_of(bodies, seed, spans), seed=seed, duration=duration, **what)]


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
