"""Who appears in a scene and when: every feature's body, place on it, birth and death.

The cast is drawn from the seed alone. Sources that observe parts of one scene in processes of
their own thus agree on the world, respawns included.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .motion import Array, Path
from .spec import Body, Gaps, Range, Respawn, SceneSpec

# Streams of random numbers; each thing has its own, so that a change of one leaves the others alone.
_PATH, _FEATURES, _GAPS, _CAMERA, _OUTLIERS, NOISE = range(6)


def stream(seed: int, *key: int) -> np.random.Generator:
    """Random numbers of one thing in the scene of a seed."""
    return np.random.default_rng([seed, *key])


@dataclass(frozen=True, eq=False)
class Cast:
    """Every feature of a scene, a row each; the id of a feature is its row.

    Attributes
    ----------
    paths
        The motion of each body; outliers are bodies of one feature.
    camera
        The motion of the observing frame, or None.
    body, object
        intp [N] index into `paths`; int32 [N] number of the true object.
    slot
        intp [N]: a feature inherits the slot of the one it replaces, and with it the source.
    local
        float64 [N, dim], place on the body.
    birth, death
        float64 [N], seconds; observed while birth <= t < death.
    gap
        float64 [N, 2], begin and end of the time it is occluded (equal: never).
    sigma, pose_sigma
        float64 [N], noise of position and, in rad, of orientation (NaN: a point).
    names
        Name of each object.
    """

    paths: list[Path]
    camera: Path | None
    body: NDArray[np.intp]
    object: NDArray[np.int32]
    slot: NDArray[np.intp]
    local: Array
    birth: Array
    death: Array
    gap: Array
    sigma: Array
    pose_sigma: Array
    names: dict[int, str]


@dataclass(frozen=True)
class _Life:
    body: int
    object: int
    slot: int
    local: Array
    birth: float
    death: float
    sigma: float
    pose_sigma: float = float("nan")


def draw_cast(spec: SceneSpec, seed: int) -> Cast:
    """Draw the features of a scene: pure, the same for the same seed."""
    names = dict(enumerate(spec.object_names))
    numbers = {name: number for number, name in names.items()}
    paths: list[Path] = []
    lives: list[_Life] = []
    slots = 0
    for index, body in enumerate(spec.bodies):
        paths.append(Path(body.motion, spec.dim, stream(seed, _PATH, index)))
        number = numbers[body.object or body.name]
        lives += _body_lives(spec, body, index, number, slots, stream(seed, _FEATURES, index))
        slots += body.features + body.poses
    _add_outliers(spec, seed, slots, paths, lives, names)
    lives.sort(key=lambda life: life.birth)
    camera = Path(spec.camera, spec.dim, stream(seed, _CAMERA)) if spec.camera else None
    return _assemble(paths, camera, lives, _gaps(spec.gaps, lives, spec.duration, stream(seed, _GAPS)), names)


def _body_lives(
    spec: SceneSpec, body: Body, index: int, number: int, slot: int, rng: np.random.Generator
) -> list[_Life]:
    size = rng.uniform(body.size.min, body.size.max, spec.dim) if isinstance(body.size, Range) else body.size
    half = np.asarray(size, np.float64) / 2.0

    def life(place: int, birth: float, death: float, pose_sigma: float = float("nan")) -> _Life:
        local = rng.uniform(-half, half)
        return _Life(index, number, slot + place, local, birth, death, body.sigma, pose_sigma)

    births = np.zeros(body.features)
    lives = []
    for at in _respawn_times(spec.respawn, spec.duration):
        replaced = rng.choice(body.features, round(spec.respawn.share * body.features), replace=False)  # type: ignore[union-attr]
        lives += [life(place, births[place], at) for place in replaced.tolist()]
        births[replaced] = at
    lives += [life(place, birth, np.inf) for place, birth in enumerate(births.tolist())]
    lives += [life(body.features + k, 0.0, np.inf, body.pose_sigma) for k in range(body.poses)]
    return lives


def _respawn_times(respawn: Respawn | None, duration: float) -> list[float]:
    """Multiples of the interval, the last instant excluded."""
    if respawn is None:
        return []
    count = int(np.ceil(duration / respawn.every - 1e-9)) - 1
    return [respawn.every * (k + 1) for k in range(count)]


def _add_outliers(
    spec: SceneSpec, seed: int, slots: int, paths: list[Path], lives: list[_Life], names: dict[int, str]
) -> None:
    if spec.outliers is None:
        return
    for k in range(round(spec.outliers.share * slots)):
        paths.append(Path(spec.outliers.motion, spec.dim, stream(seed, _OUTLIERS, k)))
        number = len(names)
        names[number] = f"outlier {k + 1}"
        local = np.zeros(spec.dim)
        lives.append(_Life(len(paths) - 1, number, slots + k, local, 0.0, np.inf, spec.outliers.sigma))


def _gaps(gaps: Gaps | None, lives: list[_Life], duration: float, rng: np.random.Generator) -> Array:
    windows = np.zeros((len(lives), 2))
    if gaps is None:
        return windows
    birth = np.array([life.birth for life in lives])
    last = np.minimum([life.death for life in lives], duration)
    begin = rng.uniform(birth, last)
    length = rng.uniform(gaps.shortest, gaps.longest, len(lives))
    hidden = (rng.uniform(size=len(lives)) < gaps.share) & (last - birth > 1.0)
    windows[hidden] = np.stack([begin, begin + length], axis=1)[hidden]
    return windows


def _assemble(
    paths: list[Path], camera: Path | None, lives: list[_Life], gap: Array, names: dict[int, str]
) -> Cast:
    return Cast(
        paths=paths,
        camera=camera,
        body=np.array([life.body for life in lives], np.intp),
        object=np.array([life.object for life in lives], np.int32),
        slot=np.array([life.slot for life in lives], np.intp),
        local=np.array([life.local for life in lives], np.float64),
        birth=np.array([life.birth for life in lives], np.float64),
        death=np.array([life.death for life in lives], np.float64),
        gap=gap,
        sigma=np.array([life.sigma for life in lives], np.float64),
        pose_sigma=np.array([life.pose_sigma for life in lives], np.float64),
        names=names,
    )
