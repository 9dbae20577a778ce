"""What a stress scene is, and what most families start from.

Bodies, features and their lives, sources, noise, and what happens when. Lengths are in m, angles in rad,
times in seconds of the scene.
"""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comotion_sources.simulator.actors import Features, Path, Poses
from comotion_sources.simulator.spec import Motion, Rest, Sines

Array: TypeAlias = NDArray[np.float64]
PoseAt: TypeAlias = Callable[[Array], Poses]
"""Poses of a body at times float64 [T] in seconds of the scene."""

# The motion of the simulator's 3-D set: two sines an axis within a place of ±0.6 m.
SWINGING = Sines(kind="sines", within=0.6, amplitude=0.25, rotation=1.5)
_GRID_S, _RAMP_S = 0.02, 0.3
OUTLIER_FACTOR = 10.0
SIGMA_M = 0.003
"""White noise of an observation, one sigma per axis, unless a family says otherwise."""


def simulated(motion: Motion, rng: np.random.Generator | None = None) -> PoseAt:
    """Draw a motion of the simulator; by default one in which nothing is random."""
    return Path(motion, 3, rng or np.random.default_rng(0)).at


def stopping(motion: PoseAt, switches: Sequence[float], *, moving: bool) -> PoseAt:
    """Play a motion at a speed that goes between 0 and its own at given times, each time within 0.3 s.

    The `switches` increase by more than 0.3 s; `moving` says whether it moves at first.
    """
    knots, speeds = [0.0], [float(moving)]
    for time in switches:
        knots += [time, time + _RAMP_S]
        speeds += [speeds[-1], 1.0 - speeds[-1]]
    grid = np.arange(0.0, knots[-1] + _GRID_S, _GRID_S)
    speed = np.interp(grid, knots, speeds)
    phase = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * _GRID_S)])

    def at(times: Array) -> Poses:
        beyond = np.maximum(times - grid[-1], 0.0) * speeds[-1]
        return motion(np.interp(times, grid, phase) + beyond)

    return at


def at_speed(motion: PoseAt, speed: float) -> PoseAt:
    """Play a motion `speed` times as fast."""
    return lambda times: motion(np.asarray(times) * speed)


def looped(motion: PoseAt, length: float) -> PoseAt:
    """Play the first `length` seconds of a motion again and again."""
    return lambda times: motion(np.mod(times, length))


def chained(turns: Sequence[PoseAt], lengths: Array) -> PoseAt:
    """Middle of the last link of a chain that begins at the origin; each link turns about its start.

    `turns` rotate each link in the axes of the one before; `lengths` float64 [links], m, are along their
    first axes.
    """

    def at(times: Array) -> Poses:
        rotations, end = np.broadcast_to(np.eye(3), (len(times), 3, 3)), np.zeros((len(times), 3))
        middle = end
        for turn, length in zip(turns, lengths.tolist(), strict=True):
            rotations = rotations @ turn(times).rotations
            along = rotations[..., 0] * length
            middle, end = end + along / 2, end + along
        return Poses(rotations, middle)

    return at


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


_BACKGROUND_SIZE = (1.6, 1.6, 1.0)
_SMALLEST, _LARGEST = 0.12, 0.4
Span: TypeAlias = tuple[float, float]
Spans: TypeAlias = list[list[Span]]
"""(birth, death) of the features of each slot, one after another, s."""
Cut: TypeAlias = tuple[float, float, NDArray[np.bool_]]
"""(lost, back, slots): features of these slots (bool [slots]) are lost; new ones come later or at once."""


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
    # Every life time of every slot has a place of its own on the slot's body.
    rows = [(birth, slot, death) for slot, lives in enumerate(spans) for birth, death in lives]
    birth, slots, death = np.array(sorted(row for row in rows if row[2] > row[0]), np.float64).T
    slot = slots.astype(np.intp)
    body = slot_bodies(bodies)[slot]
    half = np.array([owner.size for owner in bodies])[body] / 2.0
    local = rng_of(seed, "places").uniform(-1.0, 1.0, half.shape) * half
    lives = Features(slot=slot, body=body, local=local, birth=birth, death=death)
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
