"""Draws the features of a scene, body, position, birth and death of each, and moves the bodies.

The draw depends on the seed alone. Sources that observe parts of one scene in separate processes
therefore simulate the same world, including replaced features.
"""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .spec import Body, KeyStates, Motion, Range, Respawn, Rest, SceneSpec, Sines

Array: TypeAlias = NDArray[np.float64]
_SINES = 2  # per axis, as the class Sines documents
_AMPLITUDE_FACTOR = (0.7, 1.3)
# One stream of random numbers per purpose: a change of one draw does not change the others.
_PATH, _FEATURES, _GAPS, _CAMERA, _OUTLIERS, NOISE = range(6)
_COLUMNS = {"body": np.intp, "object": np.int32, "slot": np.intp} | dict.fromkeys(
    ("local", "birth", "death", "sigma", "pose_sigma"), np.float64
)
_Actor = tuple[int, int, int, Array, float, float, float, float]
"""One feature, by these columns."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of one body at T times: x = rotations @ body coordinates + translations."""

    rotations: Array  # float64 [T, dim, dim]
    translations: Array  # float64 [T, dim]


class Path:
    """The motion of one body; random parameters are drawn at construction.

    `dim` is 2 or 3; `rng` draws places, frequencies, phases and amplitudes.
    """

    def __init__(self, motion: Motion, dim: int, rng: np.random.Generator) -> None:
        self._motion = motion
        self._dim = dim
        self._turn = 1 if dim == 2 else 3
        if isinstance(motion, KeyStates):
            self._states = np.array(motion.states, np.float64)
            return
        drawn = rng.uniform(-motion.within, motion.within, dim)
        self._place = drawn if motion.at is None else np.array(motion.at, np.float64)
        if isinstance(motion, Sines):
            shape = (_SINES, dim + self._turn)
            reach = np.r_[np.full(dim, motion.amplitude), np.full(self._turn, motion.rotation)]
            self._frequency = rng.uniform(motion.frequency.min, motion.frequency.max, shape)
            self._phase = rng.uniform(0.0, 2.0 * np.pi, shape)
            self._amplitude = rng.uniform(*_AMPLITUDE_FACTOR, shape) * reach / _SINES

    def at(self, times: Array) -> Poses:
        """Compute the poses at times float64 [T], seconds of the scene."""
        times = np.atleast_1d(np.asarray(times, np.float64))
        place, turn = np.split(self._state(times), [self._dim], axis=1)
        if self._dim == 3:
            return Poses(np.asarray(Rotation.from_rotvec(turn).as_matrix(), np.float64), place)
        cos, sin = np.cos(turn[:, 0]), np.sin(turn[:, 0])
        return Poses(np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2), place)

    def _state(self, times: Array) -> Array:
        """Position and rotation coordinates: [T, 2 + 1] or [T, 3 + 3]."""
        if isinstance(self._motion, KeyStates):
            knots = self._states[:, 0]
            return np.stack([np.interp(times, knots, column) for column in self._states.T[1:]], axis=1)
        rest = np.concatenate([self._place, np.zeros(self._turn)])
        if isinstance(self._motion, Rest):
            return np.tile(rest, (len(times), 1))
        shift = self._swing(np.maximum(times - self._motion.start, 0.0))
        if self._motion.start > 0:  # the motion starts at the place of rest
            shift = shift - self._swing(np.zeros(1))
        return rest + shift

    def _swing(self, times: Array) -> Array:
        angle = 2.0 * np.pi * self._frequency * times[:, None, None] + self._phase
        return np.asarray((self._amplitude * np.sin(angle)).sum(axis=1), np.float64)


@dataclass(frozen=True, eq=False, kw_only=True)
class Features:
    """Features over time, one row each, in the order of birth."""

    body: NDArray[np.intp]  # intp [N], index of the body
    # intp [N]: a feature has the slot of the one it replaces, so the same source observes it.
    slot: NDArray[np.intp]
    local: Array  # float64 [N, dim], position in the frame of the body
    # float64 [N], seconds; observed while birth <= t < death.
    birth: Array
    death: Array

    def alive(self, rows: NDArray[np.intp], t: float) -> NDArray[np.bool_]:
        """Which of some features exist at a time, occluded ones too, bool [rows]."""
        at = t + 1e-9
        return (self.birth[rows] <= at) & (at < self.death[rows])


@dataclass(frozen=True, eq=False, kw_only=True)
class Actors(Features):
    """All features of a simulated scene; the id of a feature is its row."""

    paths: list[Path]  # the motion of each body; outliers are bodies of one feature
    camera: Path | None  # the motion of the observing frame, or None
    object: NDArray[np.int32]  # int32 [N], number of the true object
    gap: Array  # float64 [N, 2], seconds: begin and end of the occlusion (equal: none)
    # float64 [N], one-sigma noise of the position (unit of the space) and of the orientation (rad; NaN: a
    # point without orientation).
    sigma: Array
    pose_sigma: Array
    names: dict[int, str]  # object number -> name


def draw_actors(spec: SceneSpec, seed: int) -> Actors:
    """Draw the features of a scene; the same seed gives the same features."""
    names = dict(enumerate(spec.object_names))
    numbers = {name: number for number, name in names.items()}
    paths: list[Path] = []
    drawn: list[_Actor] = []
    slots = 0
    for index, body in enumerate(spec.bodies):
        paths.append(Path(body.motion, spec.dim, np.random.default_rng([seed, _PATH, index])))
        number = numbers[body.object or body.name]
        drawn += _body_actors(
            spec, body, index, number, slots, np.random.default_rng([seed, _FEATURES, index])
        )
        slots += body.features + body.poses
    _add_outliers(spec, seed, slots, paths, drawn, names)
    rows = np.array(drawn, [(name, kind, (spec.dim,)[: name == "local"]) for name, kind in _COLUMNS.items()])
    rows = rows[np.argsort(rows["birth"], kind="stable")]
    columns: dict[str, Any] = {name: np.ascontiguousarray(rows[name]) for name in _COLUMNS}
    camera = Path(spec.camera, spec.dim, np.random.default_rng([seed, _CAMERA])) if spec.camera else None
    gap = np.zeros((len(rows), 2))
    if spec.gaps is not None:
        rng, last = np.random.default_rng([seed, _GAPS]), np.minimum(columns["death"], spec.duration)
        begin = rng.uniform(columns["birth"], last)
        length = rng.uniform(spec.gaps.shortest, spec.gaps.longest, len(rows))
        hidden = (rng.uniform(size=len(rows)) < spec.gaps.share) & (last - columns["birth"] > 1.0)
        gap[hidden] = np.stack([begin, begin + length], axis=1)[hidden]
    return Actors(paths=paths, camera=camera, gap=gap, names=names, **columns)


def _body_actors(
    spec: SceneSpec, body: Body, index: int, number: int, slot: int, rng: np.random.Generator
) -> list[_Actor]:
    size = rng.uniform(body.size.min, body.size.max, spec.dim) if isinstance(body.size, Range) else body.size
    half = np.asarray(size, np.float64) / 2.0

    def actor(place: int, birth: float, death: float, pose_sigma: float = float("nan")) -> _Actor:
        local = rng.uniform(-half, half)
        return index, number, slot + place, local, birth, death, body.sigma, pose_sigma

    births = np.zeros(body.features)
    drawn = []
    respawn = spec.respawn or Respawn(every=spec.duration, share=0)
    # At the multiples of the interval, without the last instant.
    for k in range(int(np.ceil(spec.duration / respawn.every - 1e-9)) - 1):
        at = respawn.every * (k + 1)
        replaced = rng.choice(body.features, round(respawn.share * body.features), replace=False)
        drawn += [actor(place, births[place], at) for place in replaced.tolist()]
        births[replaced] = at
    drawn += [actor(place, birth, np.inf) for place, birth in enumerate(births.tolist())]
    drawn += [actor(body.features + k, 0.0, np.inf, body.pose_sigma) for k in range(body.poses)]
    return drawn


def _add_outliers(
    spec: SceneSpec, seed: int, slots: int, paths: list[Path], drawn: list[_Actor], names: dict[int, str]
) -> None:
    if spec.outliers is None:
        return
    for k in range(round(spec.outliers.share * slots)):
        paths.append(Path(spec.outliers.motion, spec.dim, np.random.default_rng([seed, _OUTLIERS, k])))
        number = len(names)
        names[number] = f"outlier {k + 1}"
        local = np.zeros(spec.dim)
        drawn.append((len(paths) - 1, number, slots + k, local, 0.0, np.inf, spec.outliers.sigma, np.nan))
